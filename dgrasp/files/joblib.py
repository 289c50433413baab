"""Read plain data that pickle or joblib wrote, compressed or not, without executing anything in it.

joblib stores a dictionary of arrays as a pickle in which each array is a `NumpyArrayWrapper` followed by
the array's raw bytes. `dgrasp.files.pickles` refuses everything else.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar

from dgrasp.errors import DataError
from dgrasp.files import sparse
from dgrasp.files.arrays import ArrayUnpickler, array_layout
from dgrasp.files.pickles import Globals, read_pickle

MAX_FILE_BYTES = 256 * 2**20
"""Largest label file that is read (the authors' largest is 1.1 MB)."""


class _ArrayWrapper:
    """Stands for joblib's wrapper of an array; the BUILD opcode gives it its state."""


class _Base:
    """Stands for `object` and `dict`, which protocols 0 and 1 name as the base of a class; it is never called."""


class PlainUnpickler(ArrayUnpickler):
    """Reads dictionaries, lists, numbers, texts, bytes, arrays and sparse matrices, as pickle or joblib writes them.

    A sparse matrix stays a `sparse.SparseStub`. `kept` are the classes of which the state is kept as data.
    """

    kept: ClassVar[tuple[type, ...]] = (sparse.SparseStub,)
    allowed: ClassVar[Globals] = {
        **ArrayUnpickler.allowed,
        **dict(sparse.names()),
        ("joblib.numpy_pickle", "NumpyArrayWrapper"): _ArrayWrapper,
        ("sklearn.externals.joblib.numpy_pickle", "NumpyArrayWrapper"): _ArrayWrapper,
        **dict.fromkeys([("copy_reg", "_reconstructor"), ("copyreg", "_reconstructor")], "reconstruct"),
        **{(module, name): _Base for module in ("__builtin__", "builtins") for name in ("object", "dict")},
    }

    def reconstruct(self, kind: Any, base: Any, content: Any) -> Any:
        """An empty object of protocol 0 or 1, or a dictionary of keys with its content."""
        if not (isinstance(kind, type) and issubclass(kind, (*self.kept, _ArrayWrapper))) or base is not _Base:
            raise DataError("malformed object")
        made = kind()
        if isinstance(made, sparse.SparseStub):
            made.entries = content
        return made

    def build(self, target: Any, state: Any) -> Any:
        if isinstance(target, self.kept):
            if not isinstance(state, dict):
                raise DataError(f"malformed state of a {type(target).__name__.strip('_')}")
            target.state = state  # type: ignore[attr-defined]
            return target
        if not isinstance(target, _ArrayWrapper):
            return super().build(target, state)
        if not isinstance(state, dict):
            raise DataError("malformed array header")
        order = state.get("order")
        shape, dtype = array_layout(state.get("shape"), state.get("dtype"), order)
        if dtype.kind == "O":
            return self._inner_pickle(shape)
        if state.get("numpy_array_alignment_bytes") is not None:
            pad = self.stream.read(1)
            if len(pad) != 1:
                raise DataError("truncated file: an array is missing")
            self.stream.read(pad[0])
        n_bytes, left = math.prod(shape) * dtype.itemsize, self.size - self.stream.tell()
        if n_bytes > left:
            raise DataError(f"truncated file: an array of {n_bytes} bytes, but {left} bytes are left")
        return self.array(self.stream.read(n_bytes), shape, dtype, order)

    def _inner_pickle(self, shape: tuple[int, ...]) -> Any:
        """An array of objects, which joblib writes as a pickle of its own; it counts towards the same limits."""
        inner = type(self)(self.stream, self.size)
        inner.steps, inner.dispatch, inner.unbuilt = self.steps, self.dispatch, self.unbuilt  # type: ignore[misc]
        array = inner.load()
        if getattr(array, "shape", None) != shape:
            raise DataError("malformed array of objects")
        return array


def read_joblib_arrays(path: Path) -> Any:
    """The object stored in a label file: dictionaries, lists, arrays and what else `PlainUnpickler` reads.

    Raises `DataError` naming the file for a missing, oversized, truncated or tampered file.
    """
    return read_pickle(path, PlainUnpickler, "label file", MAX_FILE_BYTES)
