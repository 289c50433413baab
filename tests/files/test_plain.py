"""Plain data in every protocol, compressed or not, as NumPy and SciPy of all years name their modules."""

from __future__ import annotations

import bz2
import collections
import gzip
import lzma
import pickle
import resource
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from dgrasp.errors import DataError
from dgrasp.files import sparse
from dgrasp.files.arrays import plain_text
from dgrasp.files.joblib import read_joblib_arrays
from dgrasp.files.npz import open_npz
from tests.labels.files import WRAPPER, dtype_opcodes, text

PROTOCOLS = range(6)
MATRIX = np.array([[0.0, 2.0, 0.0, 0.0], [3.0, 0.0, 0.0, -1.0]])


def read(path: Path, raw: bytes) -> Any:
    path.write_bytes(raw)
    return read_joblib_arrays(path)


def content() -> dict[Any, Any]:
    """One of each kind of plain data."""
    return {
        "whole": [0, -1, 300, 2**40, 2**70], "float": [1e-300, -0.5], "flags": [True, False, None],
        "text": ["", "a", "é" * 300], "bytes": [b"", b"\x00\xff", bytes(range(256)) * 2], 7: {8: (1, (2, 3), (), (4,))},
        "c": np.arange(6.0).reshape(2, 3), "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "turned": np.arange(24).reshape(2, 3, 4).transpose(2, 0, 1), "strided": np.arange(10.0)[::3],
        "big endian": np.arange(3, dtype=">f4"), "empty": np.zeros((0, 3)), "single": np.array(2.5),
        "bool": np.array([True, False]), "objects": np.array(["x", "yé"], dtype=object),
        "texts": np.array(["x", "yé"]), "octets": np.array([b"x", b"yz"]),
        "scalars": [np.float64(0.5), np.int32(-3), np.bool_(True), np.str_("yé"), np.bytes_(b"z")],
        "ordered": collections.OrderedDict([("b", 1), ("a", [2])]),
    }  # fmt: skip


def assert_same(found: Any, expected: Any) -> None:
    if isinstance(expected, dict):
        assert list(found) == list(expected)
        for key in expected:
            assert_same(found[key], expected[key])
    elif isinstance(expected, np.ndarray):
        assert found.shape == expected.shape and found.dtype.kind == expected.dtype.kind
        np.testing.assert_array_equal(found, expected)
    else:
        assert found == expected


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_plain_data_of_every_protocol(tmp_path: Path, protocol: int) -> None:
    found = read(tmp_path / "a.pkl", pickle.dumps(content(), protocol))
    assert_same(found, content())
    # Scalars become Python's own, which labels and messages can show.
    assert [type(value) for value in found["scalars"]] == [float, int, bool, str, bytes]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_texts_of_python_2_that_python_3_wrote_as_bytes(tmp_path: Path, protocol: int) -> None:
    found = read(tmp_path / "a.pkl", pickle.dumps({b"name": b"x", b"more": {b"a": 1, 2: 3}}, protocol))
    assert found == {"name": b"x", "more": {"a": 1, 2: 3}}


@pytest.mark.parametrize("protocol", [0, 1, 2, 3])
def test_module_names_of_numpy_1_and_2(tmp_path: Path, protocol: int) -> None:
    value = {"a": np.arange(3.0), "b": np.float32(2.0)}
    for core in (b"numpy.core", b"numpy._core"):
        raw = pickle.dumps(value, protocol).replace(b"numpy._core", b"numpy.core").replace(b"numpy.core", core)
        assert core + b".multiarray" in raw
        assert_same(read(tmp_path / "a.pkl", raw), value)


@pytest.mark.parametrize("form", sparse.FORMS)
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_sparse_matrices(tmp_path: Path, form: str, protocol: int) -> None:
    for kind in ("matrix", "array"):
        matrix = getattr(sp, f"{form}_{kind}")(MATRIX)
        found = read(tmp_path / "a.pkl", pickle.dumps({"J": matrix}, protocol))["J"]
        np.testing.assert_array_equal(sparse.dense(found, 8), MATRIX)
        with pytest.raises(DataError, match=r"shape \(2, 4\); expected at most 7 entries"):
            sparse.dense(found, 7)
    if protocol < 4:
        # SciPy before 1.8 has no underscore in its modules.
        raw = pickle.dumps({"J": matrix}, protocol)
        # SciPy 1.8 to 1.10 has its sparse arrays in one module.
        for module in (f"scipy.sparse.{form}", "scipy.sparse._arrays"):
            old = raw.replace(f"scipy.sparse._{form}\n".encode(), f"{module}\n".encode())
            assert old != raw
            np.testing.assert_array_equal(sparse.dense(read(tmp_path / "a.pkl", old)["J"], 8), MATRIX)


@pytest.mark.parametrize(
    ("form", "change"),
    [
        ("csr", {"indices": np.array([9, 0, 1])}), ("csr", {"indptr": np.array([0, 3])}),
        ("csc", {"indptr": np.array([0, 2, 1, 3, 3])}), ("csc", {"data": np.array(["a", "b", "c"])}),
        ("coo", {"coords": (np.array([5]), np.array([0]))}), ("coo", {"coords": (np.array([0.5] * 3),) * 2}),
        ("bsr", {"indices": np.array([7])}), ("bsr", {"data": np.zeros((1, 0, 4))}), ("bsr", {"data": np.zeros(3)}),
        ("dia", {"offsets": np.array([0.5])}), ("dia", {"data": np.zeros((9, 4))}),
        ("lil", {"rows": np.array([[0], None], dtype=object)}), ("lil", {"data": np.array([[2.0], []], dtype=object)}),
        ("lil", {"rows": np.array([[1], [0, 2**80]], dtype=object)}), ("dok", {"_dict": {(0, 9): 1.0}}),
        ("dok", {"_dict": {3: 1.0}}), ("dok", {"_dict": {(0, 0): "x"}}), ("csr", {"_shape": (2, -4)}),
        ("csr", {"_shape": (2,)}), ("csr", {"_shape": None}),
    ],
)  # fmt: skip
def test_damaged_sparse_matrices(form: str, change: dict[str, Any]) -> None:
    stub = sparse.STUBS[form]()
    stub.state = vars(getattr(sp, f"{form}_matrix")(MATRIX)) | change
    with pytest.raises(DataError, match="sparse matrix"):
        sparse.dense(stub, 100)


@pytest.mark.filterwarnings("ignore:the matrix subclass")
def test_matrices_of_numpy_are_arrays(tmp_path: Path) -> None:
    found = read(tmp_path / "a.pkl", pickle.dumps({"a": np.matrix([[1, 2]])}, 4))["a"]
    assert type(found) is np.ndarray and found.tolist() == [[1, 2]]


FORMS: dict[str, Callable[[bytes], bytes]] = {
    "zlib": zlib.compress, "gzip": gzip.compress, "bz2": bz2.compress, "xz": lzma.compress,
    "lzma": lambda raw: lzma.compress(raw, format=lzma.FORMAT_ALONE),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_compressed_files(tmp_path: Path, form: str) -> None:
    raw = pickle.dumps(content(), 4)
    packed = FORMS[form](raw)
    assert_same(read(tmp_path / "a.pkl", packed), content())
    # Two streams one after the other are one file, as the tools of these formats have it.
    assert_same(read(tmp_path / "a.pkl", FORMS[form](raw[:500]) + FORMS[form](raw[500:])), content())
    for end in (len(packed) // 2, len(packed) - 5):
        with pytest.raises(DataError, match=r"a\.pkl: its compression is (truncated|damaged)"):
            read(tmp_path / "a.pkl", packed[:end])


@pytest.mark.parametrize("form", FORMS)
def test_decompression_bombs(tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dgrasp.files.joblib.MAX_FILE_BYTES", 2**20)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    bomb = FORMS[form](bytes(2**26))
    made = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(DataError, match="more than 1048576 bytes when unpacked"):
        read(tmp_path / "a.pkl", bomb)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - max(before, made) < 2**15


def test_an_lzma_file_that_asks_for_a_huge_dictionary(tmp_path: Path) -> None:
    packed = bytearray(lzma.compress(pickle.dumps(content(), 4), format=lzma.FORMAT_ALONE))
    packed[1:5] = (2**30).to_bytes(4, "little")
    with pytest.raises(DataError, match="its compression is damaged"):
        read(tmp_path / "a.pkl", bytes(packed))


@pytest.mark.parametrize(("head", "name"), [(b"\x04\x22\x4d\x18", "LZ4"), (b"\x28\xb5\x2f\xfd", "Zstandard"),
                                            (b"ZF0x1e", "joblib 0.9")])
def test_compressions_that_are_refused_by_name(tmp_path: Path, head: bytes, name: str) -> None:
    with pytest.raises(DataError, match=f"compressed with {name}.*save the file with compress"):
        read(tmp_path / "a.pkl", head + bytes(20))


def test_joblibs_arrays_of_objects(tmp_path: Path) -> None:
    # joblib writes such an array as a pickle of its own, right behind the wrapper.
    value = np.array(["a", "b"], dtype=object)
    state = (b"}(" + text("shape") + b"K\x02\x85" + text("order") + text("C") + text("dtype")
             + dtype_opcodes(np.dtype("O")) + b"ub")
    raw = b"\x80\x03}" + text("names") + WRAPPER + state + pickle.dumps(value, 2) + b"s."
    assert_same(read(tmp_path / "a.pkl", raw), {"names": value})


def test_names_as_text_bytes_and_objects(tmp_path: Path) -> None:
    for value in ("a", b"a", np.array("a"), np.array([b"a"]), np.array(["a"], dtype=object)):
        assert plain_text(value) == "a"
    assert plain_text(3) is None and plain_text(b"\xff") is None and plain_text(np.array(["a", "b"])) is None
    np.savez(tmp_path / "a.npz", names=np.array(["x", "y"], dtype=object), n=np.zeros(3))
    with open_npz(tmp_path / "a.npz", "table", 10**6) as archive:
        assert archive.read("names", "O").tolist() == ["x", "y"]
    with pytest.raises(DataError, match="expected text"), open_npz(tmp_path / "a.npz", "table", 10**6) as archive:
        archive.read("names", "U")


@pytest.mark.parametrize("value", [collections.defaultdict(list), complex(1), {1, 2}, {(1, (2, 3)): 1}, Path("x"),
                                   np.zeros(2, dtype=complex), np.zeros(2, dtype=[("a", "f8")])])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_what_is_not_plain_is_refused(tmp_path: Path, value: Any, protocol: int) -> None:
    with pytest.raises(DataError, match=r"a\.pkl"):
        read(tmp_path / "a.pkl", pickle.dumps({"a": value}, protocol))


@pytest.mark.parametrize(
    "raw",
    [
        # One text of a megabyte, made to bytes again and again.
        b"\x80\x02]" + text("a" * 10**6) + b"q\x01a]("
        + (b"c_codecs\nencode\nh\x01" + text("latin1") + b"\x86R") * 1000 + b"e.",
        # One list of pairs, made to dictionaries again and again.
        b"\x80\x02](" + (text("a") + b"N\x86") * 100_000 + b"eq\x01]("
        + b"ccollections\nOrderedDict\nh\x01\x85R" * 100_000 + b"e.",
        # A buffer that announces more than there is.
        b"\x80\x05\x96" + (2**62).to_bytes(8, "little") + b".",
        b"\x80\x05\x96" + (50).to_bytes(8, "little") + b"abc.",
    ],
    ids=range(4),
)  # fmt: skip
def test_streams_made_to_fill_the_memory(tmp_path: Path, raw: bytes) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(DataError, match=r"larger than the file|steps|truncated"):
        read(tmp_path / "a.pkl", raw)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**19
