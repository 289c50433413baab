"""Read pickles of plain data and arrays without executing anything in them.

The unpickler has two allow-lists: the globals that its kind of file needs, each replaced by a harmless stand-in, and
the opcodes that plain data needs. It refuses everything else. A tampered file can hold wrong data, but it cannot
execute code or make the reader hang or crash. Keys of dictionaries may only be text and numbers: a tuple that holds
the same tuple twice, and so on forty levels deep, has a hash that takes practically forever.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import reprlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dgrasp.errors import DataError

_DTYPES = ("bool", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8", "b1")
_FLAT_KINDS = "biuf"


class DtypeStub:
    """A numpy dtype restricted to plain numbers and booleans."""

    def __init__(self, code: Any = None, align: Any = False, copy: Any = False) -> None:
        if not isinstance(code, str) or code not in _DTYPES:
            raise DataError(f"array of unsupported dtype {reprlib.repr(code)}; expected plain numbers or booleans")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        ok = isinstance(state, tuple) and len(state) >= 5 and state[1] in ("<", ">", "|", "=")
        if not ok or any(part is not None for part in state[2:5]):
            raise DataError("array dtype with fields; expected plain numbers or booleans")
        self.dtype = self.dtype.newbyteorder(state[1]) if state[1] != "|" else self.dtype


def _scalar(dtype: Any, raw: Any) -> Any:
    """numpy's pickled scalar: a dtype and its bytes, which Python 2 writes as text."""
    raw = raw.encode("latin1") if isinstance(raw, str) else raw
    if not isinstance(dtype, DtypeStub) or not isinstance(raw, bytes):
        raise DataError("malformed numpy scalar")
    if len(raw) != dtype.dtype.itemsize:
        raise DataError(f"numpy scalar of {len(raw)} bytes; expected {dtype.dtype.itemsize}")
    return np.frombuffer(raw, dtype=dtype.dtype)[0].item()


class NdarrayMarker:
    """Stands for `numpy.ndarray`, which pickled arrays name as their class; it is never called."""


Globals = dict[tuple[str, str], Any]

NUMPY_GLOBALS: Globals = {
    ("numpy", "ndarray"): NdarrayMarker,
    ("numpy", "dtype"): DtypeStub,
    ("numpy.core.multiarray", "scalar"): _scalar,
    ("numpy._core.multiarray", "scalar"): _scalar,
}
"""The globals that every file with numpy arrays needs."""


def array_layout(shape: Any, stub: Any, order: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """The checked shape and dtype of a pickled array's header; a `DataError` for anything except plain numbers."""
    if not isinstance(stub, DtypeStub) or order not in ("C", "F"):
        raise DataError("malformed array header")
    if not (isinstance(shape, tuple) and all(isinstance(n, int) and 0 <= n < 2**31 for n in shape)):
        raise DataError(f"malformed array shape {reprlib.repr(shape)}")
    if len(shape) > 8:
        raise DataError(f"array with {len(shape)} dimensions; expected at most 8")
    if stub.dtype.kind not in _FLAT_KINDS:
        raise DataError(f"array of kind {stub.dtype.kind!r}; expected numbers")
    return shape, stub.dtype


_OPCODE_NAMES = {ord(op.code): op.name for op in pickletools.opcodes}
PLAIN_OPCODES = (
    "PROTO", "FRAME", "STOP", "MARK", "GLOBAL", "STACK_GLOBAL", "REDUCE", "NEWOBJ",
    "BINPUT", "LONG_BINPUT", "MEMOIZE", "BINGET", "LONG_BINGET",
    "NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT",
    "BINUNICODE", "SHORT_BINUNICODE", "SHORT_BINBYTES", "BINBYTES",
    "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST", "APPEND", "APPENDS", "EMPTY_DICT",
)
"""Opcodes of the binary protocols that build plain data; each uses the standard library's handler."""

Dispatch = dict[int, Callable[[Any], None]]


MAX_STEPS = 1_000_000
"""Most opcodes in one file. One byte may become an object of some ten bytes, so this bounds memory and time."""


class _Opcodes(dict[int, Callable[[Any], None]]):
    """The opcodes that a file may use, and how many more of them. Looking up any other opcode raises `DataError`."""

    left = MAX_STEPS

    def __getitem__(self, code: int) -> Callable[[Any], None]:
        self.left -= 1
        if self.left < 0:
            raise DataError(f"more than {MAX_STEPS} steps to build its content; such a file needs a few thousand")
        return super().__getitem__(code)

    def __missing__(self, code: int) -> Any:
        raise DataError(
            f"the pickle uses the opcode {_OPCODE_NAMES.get(code, code)}, which such a file never needs; "
            "it was refused and nothing was executed"
        )


def opcodes(names: tuple[str, ...]) -> Dispatch:
    """The standard handlers of the named opcodes, and the checked ones that build objects and fill dictionaries."""
    table: Dispatch = {
        code: pickle._Unpickler.dispatch[code] for code, name in _OPCODE_NAMES.items() if name in names
    }
    table[pickle.BUILD[0]] = _load_build
    table[pickle.SETITEM[0]] = _load_setitem
    table[pickle.SETITEMS[0]] = _load_setitems
    if "DICT" in names:
        table[pickle.DICT[0]] = _load_dict
    return table


def _load_build(self: RestrictedUnpickler) -> None:
    state = self.stack.pop()
    self.stack[-1] = self.build(self.stack[-1], state)


def _load_setitem(self: RestrictedUnpickler) -> None:
    value = self.stack.pop()
    _set_items(self.stack, [self.stack.pop(), value])


def _load_setitems(self: RestrictedUnpickler) -> None:
    items = self.pop_mark()  # type: ignore[attr-defined]
    _set_items(self.stack, items)


def _load_dict(self: RestrictedUnpickler) -> None:
    items = self.pop_mark()  # type: ignore[attr-defined]
    self.stack.append({})
    _set_items(self.stack, items)


def _set_items(stack: list[Any], items: list[Any]) -> None:
    target, keys = stack[-1], items[::2]
    if not isinstance(target, dict) or not all(type(key) in (str, int) for key in keys):
        raise DataError("the pickle sets items of something else than a dictionary with keys of text and numbers")
    target.update(zip(keys, items[1::2], strict=True))


class RestrictedUnpickler(pickle._Unpickler):
    """Pure-Python unpickler with an allow-list of globals and one of opcodes.

    A subclass names its `allowed` globals and, if `PLAIN_OPCODES` are not enough, its `handlers`.
    """

    stack: list[Any]
    allowed: ClassVar[Globals] = NUMPY_GLOBALS
    handlers: ClassVar[Dispatch] = opcodes(PLAIN_OPCODES)

    def __init__(self, stream: io.BytesIO, size: int) -> None:
        super().__init__(stream, encoding="latin1")
        self.stream, self.size = stream, size
        # The standard library's loop looks up every opcode here.
        self.dispatch = _Opcodes(self.handlers)  # type: ignore[misc]
        self._unbuilt = size

    def find_class(self, module: str, name: str) -> Any:
        try:
            return self.allowed[(module, name)]
        except KeyError:
            raise DataError(
                f"the pickle asks for {reprlib.repr(f'{module}.{name}')}, which such a file never needs; "
                "it was refused and nothing was executed"
            ) from None

    def array(self, raw: bytes, shape: tuple[int, ...], dtype: np.dtype[Any], order: Any) -> np.ndarray:
        """The array from raw bytes, whose number must be the one that the header announces.

        All arrays together may not be larger than the file, so that no file can fill the memory by using bytes twice.
        """
        expected = math.prod(shape) * dtype.itemsize
        self._unbuilt -= len(raw)
        if len(raw) != expected or self._unbuilt < 0:
            raise DataError(f"an array of shape {shape} with {len(raw)} bytes; expected {expected}, each used once")
        # The default byte order keeps later arithmetic on the fast path.
        return np.frombuffer(raw, dtype=dtype).reshape(shape, order=order).astype(dtype.newbyteorder("="))

    def build(self, target: Any, state: Any) -> Any:
        """The object that replaces `target` on the stack once `state` is set on it."""
        if not isinstance(target, DtypeStub):
            raise DataError(f"the pickle sets state on a {type(target).__name__}; only arrays are expected")
        target.__setstate__(state)
        return target


class _ArrayStub:
    """The placeholder that `_reconstruct` returns; BUILD replaces it with the array."""


def _reconstruct(kind: Any, shape: Any, code: Any) -> _ArrayStub:
    if kind is not NdarrayMarker:
        raise DataError("malformed array")
    return _ArrayStub()


class ArrayUnpickler(RestrictedUnpickler):
    """Reads arrays that numpy itself pickled, as `_reconstruct` and their bytes, in Python 2 or 3."""

    allowed: ClassVar[Globals] = {
        **NUMPY_GLOBALS,
        ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
        ("numpy._core.multiarray", "_reconstruct"): _reconstruct,
    }
    # In Python 2, text and the bytes of arrays are 8-bit strings.
    handlers = opcodes((*PLAIN_OPCODES, "SHORT_BINSTRING", "BINSTRING"))

    def build(self, target: Any, state: Any) -> Any:
        if not isinstance(target, _ArrayStub):
            return super().build(target, state)
        if not isinstance(state, tuple) or len(state) != 5:
            raise DataError("malformed array")
        _, shape, stub, by_columns, raw = state
        if isinstance(stub, DtypeStub) and isinstance(raw, str):
            raw = raw.encode("latin1")
        if not isinstance(raw, bytes):
            raise DataError("array of objects; expected plain numbers")
        order = "F" if by_columns is True or by_columns == 1 else "C"
        shape, dtype = array_layout(shape, stub, order)
        return self.array(raw, shape, dtype, order)


def read_pickle(path: Path, unpickler: type[RestrictedUnpickler], kind: str, max_bytes: int, starts: bytes) -> Any:
    """The object of a pickle file, read by `unpickler`.

    kind: what the file is, for messages. starts: the file's first byte must be one of these. Raises `DataError` naming
    the file for a missing, oversized, truncated or tampered file.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise DataError(f"{path}: {size} bytes; a {kind} has at most {max_bytes}")
        raw = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    if not raw or raw[0] not in starts:
        raise DataError(f"{path}: not a pickle, as a {kind} is (compressed files are not supported)")
    try:
        return unpickler(io.BytesIO(raw), len(raw)).load()
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    except RecursionError:
        raise DataError(f"{path}: damaged {kind} (nested too deeply)") from None
    except Exception as error:
        # A mutated stream can fail in any opcode; whatever it raises, the file cannot be used.
        raise DataError(f"{path}: damaged {kind} ({type(error).__name__}: {str(error)[:200]})") from None
