"""Hostile label files: nothing in them is executed, and each ends in one `DataError`."""

from __future__ import annotations

import copyreg
import io
import os
import pickle
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dgrasp.errors import DataError
from dgrasp.files.joblib import read_joblib_arrays
from dgrasp.labels.formats.release import read_release
from dgrasp.labels.load import load_labels
from tests.labels.files import (
    WRAPPER,
    array_opcodes,
    dtype_opcodes,
    opcodes,
    static_content,
    text,
)
from tests.labels.test_fuzz import outcome, rewrite

pytestmark = pytest.mark.filterwarnings("error")


class _Evil:
    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[Any, Any]:
        return self.call


def _global(module: str, name: str) -> bytes:
    return b"c" + module.encode() + b"\n" + name.encode() + b"\n"


def hostile_streams(command: str, code: str) -> Iterator[tuple[str, bytes]]:
    """Pickles that would run `command` (a shell's) or `code` (Python's), or that reach for more than arrays."""
    system = _global("os", "system") + text(command) + b"\x85R"
    for protocol in (2, 3, 4, 5):
        yield f"os.system, protocol {protocol}", pickle.dumps(_Evil(os.system, command), protocol)
        yield f"exec, protocol {protocol}", pickle.dumps(_Evil(exec, code), protocol)
    head = b"\x80\x03"
    yield "posix.system", head + _global("posix", "system") + text(command) + b"\x85R."
    yield "subprocess", head + _global("subprocess", "check_call") + text(command) + b"\x85R."
    yield "eval", head + _global("builtins", "eval") + text(code) + b"\x85R."
    yield "getattr of os", head + _global("builtins", "getattr") + _global("os", "path") + text("join") + b"\x86R."
    yield "dotted name", b"\x80\x04" + text("os") + text("path.join") + b"\x93."
    yield "numpy function", head + _global("numpy", "fromfile") + text(command) + b"\x85R."
    yield "numpy object array", pickle.dumps(np.array([_Evil(os.system, command)], dtype=object), 3)
    yield "value in a dictionary", head + b"}J\x03\x00\x00\x00" + system + b"s."
    yield "key in a dictionary", head + b"}" + system + b"Ns."
    good = opcodes(static_content(objects=(3,), n=1))
    yield "after good labels", head + good + b"J\x04\x00\x00\x00" + system + b"s."
    yield "in an array's header", head + array_opcodes(np.zeros(3), False, before=text("shape") + system) + b"."
    yield "as an array's dtype", head + _global("numpy", "dtype") + system + b"\x85R."
    yield "as an array's class", head + WRAPPER + b"}(" + text("subclass") + _global("os", "system") + b"ub."
    scalar, dtype = _global("numpy.core.multiarray", "scalar"), _global("numpy", "dtype")
    yield "in a scalar", head + scalar + dtype_opcodes(np.dtype("i8")) + system + b"\x86R."
    yield "as a dtype's state", head + dtype + b"(" + text("f8") + b"\x89\x88tR(K\x03" + system + b"tb."
    yield "INST", head + b"(" + text(command) + b"ios\nsystem\n."
    yield "OBJ", head + b"(" + _global("os", "system") + text(command) + b"o."
    yield "NEWOBJ_EX", b"\x80\x04" + _global("os", "system") + text(command) + b"\x85}\x92."
    yield "NEWOBJ", head + _global("os", "system") + text(command) + b"\x85\x81."
    yield "EXT1", head + b"\x82\xf0" + text(command) + b"\x85R."
    yield "EXT2", head + b"\x83\xf0\x00" + text(command) + b"\x85R."
    yield "EXT4", head + b"\x84\xf0\x00\x00\x00" + text(command) + b"\x85R."
    yield "PERSID", head + b"P" + command.encode() + b"\n."
    yield "BINPERSID", head + text(command) + b"Q."
    yield "BUILD on a class", head + WRAPPER[:-2] + b"}(" + text("__setstate__") + _global("os", "system") + b"ub."
    yield "call of what was read", head + WRAPPER + text(command) + b"\x85R."
    called = text(command) + b"\x85R"
    for module, name in (("nt", "system"), ("pty", "spawn"), ("subprocess", "Popen"), ("os", "popen"),
                         ("runpy", "run_path"), ("builtins", "exec"), ("builtins", "__import__"),
                         ("__builtin__", "eval"), ("builtins", "open"),
                         ("importlib", "import_module"), ("operator", "attrgetter"), ("operator", "methodcaller"),
                         ("functools", "partial"), ("functools", "reduce"), ("codecs", "open"), ("_codecs", "lookup"),
                         ("ctypes", "CDLL"), ("pickle", "loads"), ("_pickle", "loads"), ("types", "FunctionType"),
                         ("numpy", "load"), ("numpy._core.multiarray", "fromfile"), ("numpy.core.numeric", "load"),
                         ("numpy.testing._private.utils", "runstring"), ("scipy.sparse", "load_npz"),
                         ("joblib", "load"), ("joblib.numpy_pickle", "load"), ("copyreg", "__newobj__"),
                         ("collections", "defaultdict"), ("dgrasp.files.pickles", "os"), ("torch", "load")):
        yield f"{module}.{name}, by GLOBAL", head + _global(module, name) + called + b"."
        yield f"{module}.{name}, by STACK_GLOBAL", b"\x80\x04" + text(module) + text(name) + b"\x93" + called + b"."
        argument = b"(S'" + command.encode() + b"'\ntRs."
        yield f"{module}.{name}, in protocol 0", b"(dS'a'\n" + _global(module, name) + argument
    # A call of what a call gives, by way of the memo, and of what the reader's own functions give.
    partial = _global("functools", "partial") + _global("os", "system") + text(command) + b"\x86R"
    yield "nested REDUCE", head + b"}" + text("a") + partial + b")Rs."
    yield "memo", head + _global("os", "system") + b"q\x01" + text(command) + b"q\x02" + b"h\x01h\x02\x85R."
    yield "memo that is a call", head + b"}" + text("a") + b"(" + system + b"q\x01th\x01s."
    yield "module name from bytes", (b"\x80\x04" + _global("_codecs", "encode") + text("os") + text("latin1") + b"\x86R"
                                     + text("system") + b"\x93" + called + b".")
    yield "call of a method of the reader", head + _global("_codecs", "encode") + _global("os", "system") + b"\x85R."
    yield "reconstructed", (head + _global("copyreg", "_reconstructor") + _global("os", "system")
                            + _global("builtins", "object") + b"N\x87R.")
    csr = _global("scipy.sparse._csr", "csr_matrix")
    yield "reconstructed base", (head + _global("copyreg", "_reconstructor") + csr + _global("os", "system")
                                 + text(command) + b"\x87R.")
    yield "state of a sparse matrix", head + csr + b")\x81}" + text("data") + system + b"sb."
    yield "setattr by BUILD", head + csr + b")\x81N}" + text("state") + _global("os", "system") + b"s\x86b."
    yield "ordered", head + _global("collections", "OrderedDict") + b"]" + text("a") + system + b"\x86a\x85R."
    yield "buffer", (head + _global("numpy._core.numeric", "_frombuffer") + b"(" + system
                     + dtype_opcodes(np.dtype("f8")) + b"K\x01\x85" + text("C") + b"tR.")
    objects = (_global("numpy._core.multiarray", "_reconstruct") + _global("numpy", "ndarray")
               + b"K\x00\x85C\x01b\x87R(K\x01K\x01\x85" + dtype_opcodes(np.dtype("O")) + b"\x89](" + system + b"etb")
    yield "in an array of objects", head + b"}" + text("a") + objects + b"s."
    yield "in joblib's pickle of objects", (
        head + b"}" + text("a") + WRAPPER + b"}(" + text("shape") + b"K\x01\x85" + text("order") + text("C")
        + text("dtype") + dtype_opcodes(np.dtype("O")) + b"ub" + head + objects + b"." + b"s.")
    yield "compressed", zlib.compress(head + b"}" + text("a") + system + b"s.")


@pytest.fixture
def in_extension_registry() -> Iterator[None]:
    copyreg.add_extension("os", "system", 0xF0)
    yield
    copyreg.remove_extension("os", "system", 0xF0)


def test_nothing_is_executed(tmp_path: Path, in_extension_registry: None, monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[Any] = []
    marker = tmp_path / "executed"
    streams = list(hostile_streams(f"touch {marker}", f"open({str(marker)!r}, 'w')"))
    assert len({name for name, _ in streams}) == len(streams) > 130
    # The real functions are out of reach too, should a test fail.
    monkeypatch.setattr(os, "system", called.append)
    path = tmp_path / "a.pkl"
    for name, raw in streams:
        rewrite(path, raw)
        for read in (read_release, load_labels):
            with pytest.raises(DataError, match=r"a\.pkl"):
                read(path)
        assert not marker.exists(), name
        assert not called, name


def _doubled(times: int) -> bytes:
    """A tuple that holds the same tuple twice, `times` deep, by way of the memo: 2 ** times leaves."""
    return b")q\x00" + b"h\x00h\x00\x86q\x00" * times


@pytest.mark.parametrize(
    "body",
    [
        b"}" + _doubled(60) + b"Ns.",
        b"}(" + _doubled(60) + b"Nu.",
        b"}" + b")" + b"\x85" * 500_000 + b"Ns.",
        _global("numpy", "dtype") + _doubled(60) + b"\x85R.",
        WRAPPER + b"}(" + text("shape") + _doubled(60) + text("order") + text("C") + text("dtype")
        + dtype_opcodes(np.dtype("f8")) + b"ub.",
        b"}J\x03\x00\x00\x00" + _doubled(60) + b"s.",
        b"}J\x03\x00\x00\x00}" + text("final_qpos") + _doubled(60) + b"ss.",
        b"}J\x03\x00\x00\x00}(" + b"".join(text(f) + _doubled(60) for f in (
            "final_qpos", "final_wpos", "final_obj", "final_contacts")) + b"us.",
        b"]" * 500_000 + b"a" * 499_999 + b".",
        b"}\x8b" + struct.pack("<I", 300_000) + b"\x01" * 300_000 + b"Ns.",
        b"}\x8a\xff" + b"\x01" * 255 + b"}s.",
        b"\x96" + struct.pack("<Q", 2**45) + b".",
        b"\x8f(" + _doubled(60) + b"\x90.",
        b"(" + _doubled(60) + b"\x91.",
        WRAPPER + b"}(" + text("shape") + b"(" + b"J\xff\xff\xff\x7f" * 8 + b"t" + text("order") + text("C")
        + text("dtype") + dtype_opcodes(np.dtype("f8")) + b"ub.",
        WRAPPER + b"}(" + text("shape") + b"(" + b"K\x00" + b"J\xff\xff\xff\x7f" * 7 + b"t" + text("order") + text("C")
        + text("dtype") + dtype_opcodes(np.dtype("f8")) + b"ub.",
    ],
    ids=range(16),
)
def test_streams_made_to_hang_crash_or_fill_the_memory(tmp_path: Path, body: bytes) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(b"\x80\x03" + body)
    assert outcome(read_release, path)


def test_framed_pickles_are_read(tmp_path: Path) -> None:
    value = {"a": [1, 2**40, -1, True, None, 0.5, "text" * 100], "b": {3: (1, 2)}}
    for protocol in (2, 3, 4, 5):
        (tmp_path / "a.pkl").write_bytes(pickle.dumps(value, protocol))
        assert read_joblib_arrays(tmp_path / "a.pkl") == value


def test_hostile_arrays_in_native_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[Any] = []
    monkeypatch.setattr(os, "system", called.append)
    stream = io.BytesIO()
    np.savez(stream, meta=np.array([_Evil(os.system, "touch x")], dtype=object))
    (tmp_path / "a.npz").write_bytes(stream.getvalue())
    assert outcome(load_labels, tmp_path / "a.npz")  # type: ignore[arg-type]
    assert not called
