"""SciPy's sparse matrices in pickles: their states, kept as data, and written out as plain arrays.

A state holds the attributes of SciPy's class of the time: `_shape` or `shape`, and what the form needs. Every index is
checked before it is used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.types import Array

FORMS = ("csr", "csc", "coo", "bsr", "dia", "lil", "dok")


class SparseStub:
    """A sparse matrix as its pickle describes it. form: one of `FORMS`."""

    form: str
    state: dict[str, Any]
    entries: Any = None
    """What a dictionary of keys held as a dictionary."""


STUBS = {form: type(f"{form}_matrix", (SparseStub,), {"form": form}) for form in FORMS}


def names() -> Iterator[tuple[tuple[str, str], type[SparseStub]]]:
    """Module and name of each of SciPy's classes, old and new, and what stands for it."""
    for form, stub in STUBS.items():
        for module in (form, f"_{form}"):
            for kind in ("matrix", "array"):
                yield (f"scipy.sparse.{module}", f"{form}_{kind}"), stub
        yield ("scipy.sparse._arrays", f"{form}_array"), stub  # SciPy 1.8 to 1.10


def dense(stub: SparseStub, max_size: int) -> Array:
    """The matrix as an array (rows, columns). Raises `DataError` for more than `max_size` entries and bad indices."""
    state = getattr(stub, "state", None)
    shape: Any = None if state is None else state.get("_shape", state.get("shape"))
    if not (isinstance(shape, tuple) and len(shape) == 2 and all(isinstance(n, int) and n > 0 for n in shape)):
        raise DataError("damaged sparse matrix")
    if math.prod(shape) > max_size:
        raise DataError(f"sparse matrix of shape {shape}; expected at most {max_size} entries")
    rows, columns, values = _TRIPLES[stub.form](stub, state, shape)
    whole = rows.dtype.kind in "iu" and columns.dtype.kind in "iu"
    if not whole or values.dtype.kind not in "biuf" or not len(rows) == len(columns) == len(values):
        raise DataError("sparse matrix whose indices do not fit")
    if len(rows) and not (min(rows.min(), columns.min()) >= 0 and rows.max() < shape[0] and columns.max() < shape[1]):
        raise DataError("sparse matrix whose indices do not fit")
    out = np.zeros(shape)
    np.add.at(out, (rows, columns), values)
    return out


def _vectors(state: Any, *names: str) -> list[Array]:
    found = [state.get(name) for name in names]
    if not all(isinstance(part, np.ndarray) and part.ndim == 1 for part in found):
        raise DataError("damaged sparse matrix")
    return found


def _outer(starts: Array, inner: Array, n_outer: int, n_entries: int) -> Array:
    """Which row, or column, each entry belongs to, by where each begins."""
    whole = inner.dtype.kind in "iu" and starts.dtype.kind in "iu"
    if not whole or len(starts) != n_outer + 1 or not (starts[0] == 0 and starts[-1] == n_entries == len(inner)):
        raise DataError("sparse matrix whose indices do not fit")
    counts: Array = np.diff(starts.astype(np.int64))
    if (counts < 0).any():
        raise DataError("sparse matrix whose indices do not fit")
    return np.repeat(np.arange(n_outer), counts)


def _compressed(stub: SparseStub, state: Any, shape: tuple[int, int]) -> tuple[Array, Array, Array]:
    data, inner, starts = _vectors(state, "data", "indices", "indptr")
    outer = _outer(starts, inner, shape[0 if stub.form == "csr" else 1], len(data))
    return (outer, inner, data) if stub.form == "csr" else (inner, outer, data)


def _blocks(stub: SparseStub, state: Any, shape: tuple[int, int]) -> tuple[Array, Array, Array]:
    inner, starts = _vectors(state, "indices", "indptr")
    data = state.get("data")
    fits = isinstance(data, np.ndarray) and data.ndim == 3 and min(data.shape[1:]) > 0
    if not fits or shape[0] % data.shape[1] or shape[1] % data.shape[2]:
        raise DataError("damaged sparse matrix")
    high, wide = data.shape[1:]
    outer = _outer(starts, inner, shape[0] // high, len(data))
    rows = (outer[:, None] * high + np.arange(high))[:, :, None]
    columns = (inner.astype(np.int64)[:, None] * wide + np.arange(wide))[:, None, :]
    return np.broadcast_to(rows, data.shape).ravel(), np.broadcast_to(columns, data.shape).ravel(), data.ravel()


def _coordinates(stub: SparseStub, state: Any, shape: tuple[int, int]) -> tuple[Array, Array, Array]:
    pair = state.get("coords", (state.get("row"), state.get("col")))
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise DataError("damaged sparse matrix")
    rows, columns, data = _vectors({"row": pair[0], "col": pair[1], "data": state.get("data")}, "row", "col", "data")
    return rows, columns, data


def _diagonals(stub: SparseStub, state: Any, shape: tuple[int, int]) -> tuple[Array, Array, Array]:
    (offsets,), data = _vectors(state, "offsets"), state.get("data")
    fits = isinstance(data, np.ndarray) and data.ndim == 2 and len(data) == len(offsets) and offsets.dtype.kind in "iu"
    if not fits or len(offsets) > sum(shape):
        raise DataError("damaged sparse matrix")
    columns = np.broadcast_to(np.arange(data.shape[1]), data.shape)
    rows = columns - offsets.astype(np.int64)[:, None]
    # Entries of a diagonal beyond the matrix are never used.
    inside = (rows >= 0) & (rows < shape[0]) & (columns < shape[1])
    return rows[inside], columns[inside], data[inside]


def _lists(stub: SparseStub, state: Any, shape: tuple[int, int]) -> tuple[Array, Array, Array]:
    columns, values = _vectors(state, "rows", "data")
    lists = [*columns.tolist(), *values.tolist()]
    if len(columns) != shape[0] or len(values) != shape[0] or not all(isinstance(part, list) for part in lists):
        raise DataError("damaged sparse matrix")
    counts = [len(part) for part in columns.tolist()]
    return np.repeat(np.arange(shape[0]), counts), _numbers(columns.tolist()), _numbers(values.tolist())


def _numbers(lists: list[list[Any]]) -> Array:
    flat = [value for part in lists for value in part]
    if not all(isinstance(value, (int, float)) and abs(value) < 2**53 for value in flat):
        raise DataError("damaged sparse matrix")
    return np.array(flat) if flat else np.zeros(0, dtype=int)


def _keys(stub: SparseStub, state: Any, shape: tuple[int, int]) -> tuple[Array, Array, Array]:
    entries = state.get("_dict", stub.entries)
    if not isinstance(entries, dict) or not all(isinstance(key, tuple) for key in entries):
        raise DataError("damaged sparse matrix")
    rows, columns = (_numbers([[key[i] for key in entries]]) for i in (0, 1))
    return rows, columns, _numbers([list(entries.values())])


_TRIPLES = {
    "csr": _compressed, "csc": _compressed, "bsr": _blocks, "coo": _coordinates, "dia": _diagonals, "lil": _lists,
    "dok": _keys,
}  # fmt: skip
"""Per form, what makes (rows, columns, values) of a state; `dense` checks them."""
