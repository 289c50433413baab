"""Read pickles of plain data and arrays without ever running what they say.

An unpickler with two allow-lists: the globals that its kind of file needs, each answered by a harmless
stand-in, and the opcodes that plain data needs. Everything else is refused, so a tampered file can be wrong but
cannot execute code, and cannot make the reader hang or crash: keys of dictionaries are text and numbers only,
because the hash of a tuple that holds itself twice, forty times over, never ends.
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
    """numpy's pickled scalar: a dtype and its bytes, which Python 2 writes as a text."""
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
"""What every file with arrays of numpy needs."""


def array_layout(shape: Any, stub: Any, order: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """The checked shape and dtype of a pickled array's header; a `DataError` for anything but plain numbers."""
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
"""Opcodes of the binary protocols that build plain data; each is the standard library's own."""

Dispatch = dict[int, Callable[[Any], None]]


MAX_STEPS = 1_000_000
"""Most opcodes of one file: each may make an object of some ten bytes out of one, so they bound memory and time."""


class _Opcodes(dict[int, Callable[[Any], None]]):
    """The opcodes that a file may use, and how many more of them; looking up another one raises."""

    left = MAX_STEPS

    def __getitem__(self, code: int) -> Callable[[Any], None]:
        self.left -= 1
        if self.left < 0:
            raise DataError(f"more than {MAX_STEPS} steps to build its content; such a file needs some thousand")
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
        raise DataError("the pickle sets items other than a dictionary's by text and numbers")
    target.update(zip(keys, items[1::2], strict=True))


class RestrictedUnpickler(pickle._Unpickler):
    """Pure-Python unpickler with an allow-list of globals and one of opcodes.

    A subclass names its `allowed` globals and, where `PLAIN_OPCODES` do not do, its `handlers`.
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
        """The array of raw bytes, which must be just as many as the header announces.

        All arrays together are no larger than the file, so that no bytes are used twice to fill the memory.
        """
        expected = math.prod(shape) * dtype.itemsize
        self._unbuilt -= len(raw)
        if len(raw) != expected or self._unbuilt < 0:
            raise DataError(f"an array of shape {shape} with {len(raw)} bytes; expected {expected}, each used once")
        # The default byte order keeps later arithmetic on the fast path.
        return np.frombuffer(raw, dtype=dtype).reshape(shape, order=order).astype(dtype.newbyteorder("="))

    def build(self, target: Any, state: Any) -> Any:
        """What stands on the stack after `state` was given to `target`."""
        if not isinstance(target, DtypeStub):
            raise DataError(f"the pickle sets state on a {type(target).__name__}; only arrays are expected")
        target.__setstate__(state)
        return target


class _ArrayStub:
    """What `_reconstruct` leaves; BUILD replaces it by the array."""


def _reconstruct(kind: Any, shape: Any, code: Any) -> _ArrayStub:
    if kind is not NdarrayMarker:
        raise DataError("malformed array")
    return _ArrayStub()


class ArrayUnpickler(RestrictedUnpickler):
    """Reads arrays as numpy pickles them itself, by `_reconstruct` and their bytes, from Python 2 or 3."""

    allowed: ClassVar[Globals] = {
        **NUMPY_GLOBALS,
        ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
        ("numpy._core.multiarray", "_reconstruct"): _reconstruct,
    }
    # Texts and array bytes of Python 2 are its 8-bit strings.
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

    kind: what the file is, for messages. starts: the file's first byte is one of these. Raises `DataError` naming
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
        # A mutated stream can fail in any opcode; whatever it raises, the file is of no use.
        raise DataError(f"{path}: damaged {kind} ({type(error).__name__}: {str(error)[:200]})") from None
