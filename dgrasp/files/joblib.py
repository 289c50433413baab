"""Read label pickles written by joblib without executing anything in them.

joblib stores a dictionary of arrays as a pickle in which each array is a `NumpyArrayWrapper` followed by
the array's raw bytes. `dgrasp.files.pickles` refuses everything else.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar

from dgrasp.errors import DataError
from dgrasp.files.pickles import NUMPY_GLOBALS, Globals, RestrictedUnpickler, array_layout, read_pickle

MAX_FILE_BYTES = 256 * 2**20
"""Largest label file that is read (the authors' largest is 1.1 MB)."""


class _ArrayWrapper:
    """joblib's placeholder for an array in the pickle; the BUILD opcode fills it in."""


class _LabelUnpickler(RestrictedUnpickler):
    """Reads raw array bytes at BUILD, as joblib wrote them."""

    allowed: ClassVar[Globals] = {**NUMPY_GLOBALS, ("joblib.numpy_pickle", "NumpyArrayWrapper"): _ArrayWrapper}

    def build(self, target: Any, state: Any) -> Any:
        if not isinstance(target, _ArrayWrapper):
            return super().build(target, state)
        if not isinstance(state, dict):
            raise DataError("malformed array header")
        order = state.get("order")
        shape, dtype = array_layout(state.get("shape"), state.get("dtype"), order)
        if state.get("numpy_array_alignment_bytes") is not None:
            pad = self.stream.read(1)
            if len(pad) != 1:
                raise DataError("truncated file: an array is missing")
            self.stream.read(pad[0])
        n_bytes, left = math.prod(shape) * dtype.itemsize, self.size - self.stream.tell()
        if n_bytes > left:
            raise DataError(f"truncated file: an array of {n_bytes} bytes, but {left} bytes are left")
        return self.array(self.stream.read(n_bytes), shape, dtype, order)


def read_joblib_arrays(path: Path) -> Any:
    """The object stored in a joblib label file: dictionaries, lists and arrays of plain numbers.

    Raises `DataError` naming the file for a missing, oversized, compressed, truncated or tampered file.
    """
    return read_pickle(path, _LabelUnpickler, "label file", MAX_FILE_BYTES, starts=b"\x80")
