"""Read label pickles written by joblib without ever running what a pickle says.

joblib stores a dictionary of arrays as a pickle in which each array is a `NumpyArrayWrapper` followed by
the array's raw bytes. The reader below accepts just the handful of globals and opcodes that such a file
needs and refuses everything else, so a tampered file can be wrong but cannot execute code, and cannot make
the reader hang or crash: keys are text and numbers only, because the hash of a tuple that holds itself twice,
forty times over, never ends.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import reprlib
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dgrasp.errors import DataError

MAX_FILE_BYTES = 256 * 2**20
"""Largest label file that is read (the authors' largest has 1.1 MB)."""

_DTYPES = ("bool", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8", "b1")
_FLAT_KINDS = "biuf"


class _ArrayWrapper:
    """What joblib leaves in the pickle in place of an array; filled in by the BUILD opcode."""

    state: dict[str, Any]


class _DtypeStub:
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
    """numpy's pickled scalar: a dtype and its bytes."""
    if not isinstance(dtype, _DtypeStub) or not isinstance(raw, bytes):
        raise DataError("malformed numpy scalar")
    if len(raw) != dtype.dtype.itemsize:
        raise DataError(f"numpy scalar of {len(raw)} bytes; expected {dtype.dtype.itemsize}")
    return np.frombuffer(raw, dtype=dtype.dtype)[0].item()


class _NdarrayMarker:
    """Stands for `numpy.ndarray`, which the wrapper names as its subclass; it is never called."""


_ALLOWED: dict[tuple[str, str], Any] = {
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _ArrayWrapper,
    ("numpy", "ndarray"): _NdarrayMarker,
    ("numpy", "dtype"): _DtypeStub,
    ("numpy.core.multiarray", "scalar"): _scalar,
    ("numpy._core.multiarray", "scalar"): _scalar,
}


_OPCODE_NAMES = {ord(op.code): op.name for op in pickletools.opcodes}
_HARMLESS = (
    "PROTO", "FRAME", "STOP", "MARK", "GLOBAL", "STACK_GLOBAL", "REDUCE", "NEWOBJ",
    "BINPUT", "LONG_BINPUT", "MEMOIZE", "BINGET", "LONG_BINGET",
    "NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT",
    "BINUNICODE", "SHORT_BINUNICODE", "SHORT_BINBYTES", "BINBYTES",
    "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST", "APPEND", "APPENDS", "EMPTY_DICT",
)


class _Opcodes(dict[int, Any]):
    """The opcodes that a label file may use; looking up another one raises."""

    def __missing__(self, code: int) -> Any:
        raise DataError(
            f"the pickle uses the opcode {_OPCODE_NAMES.get(code, code)}, which a label file never needs; "
            "it was refused and nothing was executed"
        )


class _LabelUnpickler(pickle._Unpickler):
    """Pure-Python unpickler with an allow-list; raw array bytes are read at BUILD, as joblib wrote them."""

    stack: list[Any]
    dispatch: ClassVar[dict[int, Any]] = _Opcodes(
        {code: pickle._Unpickler.dispatch[code] for code, name in _OPCODE_NAMES.items() if name in _HARMLESS}
    )

    def __init__(self, stream: io.BytesIO, size: int) -> None:
        super().__init__(stream)
        self._stream, self._size = stream, size

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _ALLOWED[(module, name)]
        except KeyError:
            raise DataError(
                f"the pickle asks for {reprlib.repr(f'{module}.{name}')}, which a label file never needs; "
                "it was refused and nothing was executed"
            ) from None

    def _load_build(self) -> None:
        stack = self.stack
        state = stack.pop()
        target = stack[-1]
        if isinstance(target, _DtypeStub):
            target.__setstate__(state)
        elif isinstance(target, _ArrayWrapper):
            if not isinstance(state, dict):
                raise DataError("malformed array header")
            stack[-1] = self._read_array(state)
        else:
            raise DataError(f"the pickle sets state on a {type(target).__name__}; only arrays are expected")

    dispatch[pickle.BUILD[0]] = _load_build

    def _load_setitem(self) -> None:
        value = self.stack.pop()
        self._set_items([self.stack.pop(), value])

    dispatch[pickle.SETITEM[0]] = _load_setitem

    def _load_setitems(self) -> None:
        self._set_items(self.pop_mark())  # type: ignore[attr-defined]

    dispatch[pickle.SETITEMS[0]] = _load_setitems

    def _set_items(self, items: list[Any]) -> None:
        target = self.stack[-1]
        keys = items[::2]
        if not isinstance(target, dict) or not all(type(key) in (str, int) for key in keys):
            raise DataError("the pickle sets items other than a dictionary's by text and numbers")
        target.update(zip(keys, items[1::2], strict=True))

    def _read_array(self, state: dict[str, Any]) -> np.ndarray:
        shape, stub, order = state.get("shape"), state.get("dtype"), state.get("order")
        if not isinstance(stub, _DtypeStub) or order not in ("C", "F"):
            raise DataError("malformed array header")
        if not (isinstance(shape, tuple) and all(isinstance(n, int) and 0 <= n < 2**31 for n in shape)):
            raise DataError(f"malformed array shape {reprlib.repr(shape)}")
        if len(shape) > 8:
            raise DataError(f"array with {len(shape)} dimensions; expected at most 8")
        if stub.dtype.kind not in _FLAT_KINDS:
            raise DataError(f"array of kind {stub.dtype.kind!r}; expected numbers")
        if state.get("numpy_array_alignment_bytes") is not None:
            pad = self._stream.read(1)
            if len(pad) != 1:
                raise DataError("truncated file: an array is missing")
            self._stream.read(pad[0])
        n_bytes = math.prod(shape) * stub.dtype.itemsize
        left = self._size - self._stream.tell()
        if n_bytes > left:
            raise DataError(f"truncated file: an array of {n_bytes} bytes, but {left} bytes are left")
        array = np.frombuffer(self._stream.read(n_bytes), dtype=stub.dtype)
        # The default byte order keeps later arithmetic on the fast path.
        return array.reshape(shape, order=order).astype(stub.dtype.newbyteorder("="))


def read_joblib_arrays(path: Path) -> Any:
    """The object stored in a joblib label file: dictionaries, lists and arrays of plain numbers.

    Raises `DataError` naming the file for a missing, oversized, compressed, truncated or tampered file.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise DataError(f"{size} bytes; a label file has at most {MAX_FILE_BYTES}")
        raw = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    if not raw.startswith(b"\x80"):
        raise DataError(f"{path}: not a joblib pickle (compressed files are not supported)")
    try:
        return _LabelUnpickler(io.BytesIO(raw), len(raw)).load()
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    except RecursionError:
        raise DataError(f"{path}: damaged label file (nested too deeply)") from None
    except Exception as error:
        # A mutated stream can fail in any opcode; whatever it raises, the file is not a label file.
        raise DataError(f"{path}: damaged label file ({type(error).__name__}: {error})") from None
