"""Stand-ins for the names of NumPy in pickles, and an unpickler that builds arrays from their bytes.

NumPy 1 and 2 name their modules `numpy.core` and `numpy._core`. Protocols 0 to 2 write the bytes of an array as text,
which `_codecs.encode` turns back; protocol 5 writes a buffer, which `_frombuffer` takes.
"""

from __future__ import annotations

import math
import re
import reprlib
from typing import Any, ClassVar

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.pickles import Globals, RestrictedUnpickler

_DTYPE = re.compile(r"bool|b1|[iu][1248]|f[248]|[US]\d{1,5}|O[48]?")
_SMALL = 32
"""Bytes. Larger scalars are counted like arrays."""


class DtypeStub:
    """A numpy dtype restricted to plain numbers, booleans, texts, bytes and, for arrays of such, objects."""

    def __init__(self, code: Any = None, align: Any = False, copy: Any = False) -> None:
        if not isinstance(code, str) or not _DTYPE.fullmatch(code):
            raise DataError(f"array of unsupported dtype {reprlib.repr(code)}; expected plain numbers or booleans")
        self.dtype = np.dtype(code[0] if code[0] == "O" else code)

    def __setstate__(self, state: Any) -> None:
        ok = isinstance(state, tuple) and len(state) >= 5 and state[1] in ("<", ">", "|", "=")
        if not ok or any(part is not None for part in state[2:5]):
            raise DataError("array dtype with fields; expected plain numbers or booleans")
        self.dtype = self.dtype.newbyteorder(state[1]) if state[1] != "|" else self.dtype


class NdarrayMarker:
    """Stands for `numpy.ndarray`, which pickled arrays name as their class; it is never called."""


class _ArrayStub:
    """What `_reconstruct` leaves; BUILD replaces it by the array."""


def _reconstruct(kind: Any, shape: Any, code: Any) -> _ArrayStub:
    if kind is not NdarrayMarker:
        raise DataError("malformed array")
    return _ArrayStub()


def array_layout(shape: Any, stub: Any, order: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """The checked shape and dtype of a pickled array's header; a `DataError` for anything else."""
    if not isinstance(stub, DtypeStub) or order not in ("C", "F"):
        raise DataError("malformed array header")
    if isinstance(shape, tuple) and len(shape) > 8:
        raise DataError(f"array with {len(shape)} dimensions; expected at most 8")
    if not (isinstance(shape, tuple) and all(isinstance(n, int) and 0 <= n < 2**31 for n in shape)):
        raise DataError(f"malformed array shape {reprlib.repr(shape)}")
    return shape, stub.dtype


def _names(module: str, *names: str) -> list[tuple[str, str]]:
    """(module, name) in the modules of NumPy 1 and 2."""
    return [(f"numpy.{core}.{module}", name) for core in ("core", "_core") for name in names]


class ArrayUnpickler(RestrictedUnpickler):
    """Reads arrays and scalars as numpy pickles them itself, in any protocol, from Python 2 or 3."""

    allowed: ClassVar[Globals] = {
        **RestrictedUnpickler.allowed,
        ("numpy", "dtype"): DtypeStub,
        **dict.fromkeys([("numpy", "ndarray"), ("numpy", "matrix"), ("numpy", "memmap"),
                         ("numpy.matrixlib.defmatrix", "matrix"), *_names("memmap", "memmap")], NdarrayMarker),
        **dict.fromkeys(_names("multiarray", "_reconstruct"), _reconstruct),
        **dict.fromkeys(_names("multiarray", "scalar"), "scalar"),
        **dict.fromkeys(_names("numeric", "_frombuffer"), "from_buffer"),
    }  # fmt: skip

    def scalar(self, stub: Any, raw: Any) -> Any:
        """numpy's pickled scalar as Python's: a dtype and its bytes, which Python 2 writes as a text."""
        raw = raw.encode("latin1") if isinstance(raw, str) else raw
        if not isinstance(stub, DtypeStub) or not isinstance(raw, bytes) or stub.dtype.kind == "O":
            raise DataError("malformed numpy scalar")
        if len(raw) != stub.dtype.itemsize:
            raise DataError(f"numpy scalar of {len(raw)} bytes; expected {stub.dtype.itemsize}")
        if len(raw) > _SMALL:
            self.spend("arrays", len(raw))
        return _flat(raw, stub.dtype)[0].item()

    def from_buffer(self, raw: Any, stub: Any, shape: Any, order: Any, axes: Any = None) -> np.ndarray:
        """The array of protocol 5. Order K: in the order of the memory, the axes put in their places by `axes`."""
        if not isinstance(raw, (bytes, bytearray)):
            raise DataError("malformed array buffer")
        shape, dtype = array_layout(shape, stub, "C" if order == "K" else order)
        if order != "K":
            return self.array(raw, shape, dtype, order)
        if not isinstance(axes, tuple) or len(axes) != len(shape) or not all(isinstance(axis, int) for axis in axes):
            raise DataError("malformed array buffer")
        return self.array(raw, shape, dtype, "C").transpose(axes)

    def array(self, raw: bytes | bytearray, shape: tuple[int, ...], dtype: np.dtype[Any], order: Any) -> np.ndarray:
        """The array of raw bytes, which must be just as many as the header announces.

        All arrays together are no larger than the file, so that no bytes are used twice to fill the memory.
        """
        if dtype.kind == "O":
            raise DataError("array of objects without its objects")
        expected = math.prod(shape) * dtype.itemsize
        if len(raw) != expected:
            raise DataError(f"an array of shape {shape} with {len(raw)} bytes; expected {expected}, each used once")
        self.spend("arrays", len(raw))
        # The default byte order keeps later arithmetic on the fast path.
        return _flat(raw, dtype).reshape(shape, order=order).astype(dtype.newbyteorder("="))

    def objects(self, items: Any, shape: tuple[int, ...], order: Any) -> np.ndarray:
        """An array of objects, which were read like everything else."""
        if not isinstance(items, list) or len(items) != math.prod(shape):
            raise DataError(f"an array of shape {shape} without as many objects")
        self.steps.take(len(items))
        array = np.empty(len(items), dtype=object)
        for i, item in enumerate(items):
            array[i] = item
        return array.reshape(shape, order=order)

    def build(self, target: Any, state: Any) -> Any:
        if isinstance(target, DtypeStub):
            target.__setstate__(state)
            return target
        if not isinstance(target, _ArrayStub):
            return super().build(target, state)
        if not isinstance(state, tuple) or len(state) != 5:
            raise DataError("malformed array")
        _, shape, stub, by_columns, raw = state
        order = "F" if by_columns is True or by_columns == 1 else "C"
        shape, dtype = array_layout(shape, stub, order)
        if dtype.kind == "O":
            return self.objects(raw, shape, order)
        raw = raw.encode("latin1") if isinstance(raw, str) else raw
        if not isinstance(raw, bytes):
            raise DataError("array of objects; expected plain numbers")
        return self.array(raw, shape, dtype, order)


def _flat(raw: bytes | bytearray, dtype: np.dtype[Any]) -> np.ndarray:
    """(n,) of raw bytes; texts hold code points alone."""
    flat: np.ndarray = np.frombuffer(raw, dtype=dtype)
    points = np.frombuffer(raw, np.dtype("u4").newbyteorder(dtype.byteorder)) if dtype.kind == "U" else np.zeros(0)
    if points.size and points.max() > 0x10FFFF:
        raise DataError("an array of text with numbers that are no characters")
    return flat


def plain_text(value: Any) -> str | None:
    """A name that a file holds as text, as bytes, or as an array of one of them; None for anything else."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    if isinstance(value, bytes):
        try:
            return value.decode("utf-8")
        except UnicodeDecodeError:
            return None
    return str(value) if isinstance(value, str) else None
