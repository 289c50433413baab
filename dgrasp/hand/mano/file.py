"""Read MANO's hand model files (MANO_RIGHT.pkl, MANO_LEFT.pkl) without chumpy and without running their pickle.

A file is a Python 2 pickle of a dictionary: plain arrays, a sparse matrix, and expressions of the chumpy
library, of which two kinds occur: `Ch`, which is its array `x`, and `Select`, which picks the entries `idxs` of a
flattened expression `a`. Both are read as data; `dgrasp.files.pickles` refuses everything else.
"""

from __future__ import annotations

import reprlib
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files import sparse
from dgrasp.files.arrays import plain_text
from dgrasp.files.joblib import PlainUnpickler
from dgrasp.files.npz import open_npz
from dgrasp.files.pickles import Globals, read_pickle
from dgrasp.hand.mano.model import EXTENT, MANO_PARENTS, ManoModel, finger_side, tip_vertices
from dgrasp.types import Array

MAX_FILE_BYTES = 16 * 2**20
"""Largest pickle that is read (MANO's have 4 MB)."""
MAX_UNPACKED_BYTES = 64 * 2**20
ENTRIES = ("v_template", "f", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "hands_mean",
           "hands_components", "bs_style", "bs_type")  # fmt: skip
"""What is read of a file."""
MAX_VERTICES, MAX_SHAPES = 10_000, 400
_GIVE = "give MANO_RIGHT.pkl or MANO_LEFT.pkl"


class _Chumpy:
    """A chumpy expression: its state as data. Nothing in the file can evaluate it."""

    state: dict[str, Any]


class _Select(_Chumpy):
    """chumpy.reordering.Select."""


def _set(items: Any = ()) -> None:
    """In place of sets: chumpy's states hold sets of names, which are not needed."""


class _ManoUnpickler(PlainUnpickler):
    """Reads plain data and keeps the states of chumpy's objects as well."""

    kept = (sparse.SparseStub, _Chumpy)
    allowed: ClassVar[Globals] = {
        **PlainUnpickler.allowed,
        ("chumpy.ch", "Ch"): _Chumpy,
        ("chumpy.reordering", "Select"): _Select,
        ("__builtin__", "set"): _set,
        ("builtins", "set"): _set,
    }


def read_mano(path: Path) -> ManoModel:
    """Read and check the hand model of a MANO file.

    Raises `DataError` naming file and entry for a file that is missing, damaged, not a MANO hand, or in another unit,
    frame or order of fingers than MANO's.
    """
    path = Path(path)
    if path.suffix == ".npz":
        return model_of(_read_npz(path), path)
    return model_of(read_pickle(path, _ManoUnpickler, "MANO file", MAX_FILE_BYTES), path)


def _read_npz(path: Path) -> dict[str, Any]:
    """MANO's entries of a .npz; an array of one object, such as a sparse matrix, is that object."""
    with open_npz(path, "MANO file", MAX_UNPACKED_BYTES) as archive:
        there = [name.removesuffix(".npy") for name in archive.names]
        content = {name: archive.read(name, "biufUSO", _ManoUnpickler) for name in there if name in ENTRIES}
    # The others are not read; a message may name them.
    return dict.fromkeys(there) | {name: array.item() if array.shape == () else array
                                   for name, array in content.items()}


def model_of(content: Any, path: Path) -> ManoModel:
    """The hand model of a dictionary with MANO's entries, checked as in `read_mano`. path: where it comes from."""
    try:
        return _model(content)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None


def _model(content: Any) -> ManoModel:
    if not isinstance(content, dict):
        raise DataError(f"holds a {type(content).__name__}; expected a dictionary; {_GIVE}")
    for key, expected in (("bs_style", "lbs"), ("bs_type", "lrotmin")):
        if key in content and plain_text(content[key]) != expected:
            raise DataError(f"{key} is {reprlib.repr(content[key])}; expected {expected!r}, MANO's skinning")
    template = _array(content, "v_template", (None, 3))
    n = len(template)
    if not 16 <= n <= MAX_VERTICES:
        raise DataError(f"{n} vertices; expected 16 to {MAX_VERTICES} (MANO has 778)")
    shapes = _array(content, "shapedirs", (n, 3, None))
    if shapes.shape[2] > MAX_SHAPES:
        raise DataError(f"{shapes.shape[2]} shape components; expected at most {MAX_SHAPES} (MANO has 10)")
    weights = _array(content, "weights", (n, 16))
    if weights.min() < -1e-6 or np.abs(weights.sum(axis=1) - 1.0).max() > 1e-3:
        raise DataError("weights are negative or do not sum to 1 for every vertex; get the file again")
    kintree = _array(content, "kintree_table", (2, 16), whole=True)
    if kintree[0, 1:].tolist() != list(MANO_PARENTS[1:]) or kintree[1].tolist() != list(range(16)):
        raise DataError(f"kintree_table has parents {kintree[0, 1:].tolist()}; expected {list(MANO_PARENTS[1:])}, "
                        "the tree of MANO's hand")
    faces = _array(content, "f", (None, 3), whole=True)
    if len(faces) == 0 or len(faces) > 4 * n or faces.min() < 0 or faces.max() >= n:
        raise DataError(f"f holds {len(faces)} faces with vertices outside 0 to {n - 1}, or too many or none")
    regressor = _array(content, "J_regressor", (16, n))
    joints = regressor @ template
    _check_geometry(template, joints)
    side = finger_side(joints)
    kintree[0, 0] = -1
    return ManoModel(
        template=template, shape_basis=shapes, pose_basis=_array(content, "posedirs", (n, 3, 135)),
        J_regressor=regressor, weights=weights, faces=faces, kintree=kintree,
        hands_mean=_array(content, "hands_mean", (45,)), hands_components=_array(content, "hands_components", (45, 45)),
        side=side, tip_vertices=tip_vertices(template, joints, weights, side),
    )


def _check_geometry(template: Array, joints: Array) -> None:
    """Check that the unit is m, the joints lie inside the hand, and the fingers are in MANO's order."""
    extent = float(np.ptp(template, axis=0).max())
    if not EXTENT[0] <= extent <= EXTENT[1]:
        raise DataError(f"the hand is {extent:g} long; expected {EXTENT[0]:g} to {EXTENT[1]:g} m; convert the file")
    outside = (joints < template.min(axis=0) - 0.02) | (joints > template.max(axis=0) + 0.02)
    if outside.any():
        raise DataError("J_regressor puts joints outside the hand; get the file again")
    little, ring = (float(np.linalg.norm(joints[j] - joints[1])) for j in (7, 10))
    if little <= ring:
        raise DataError("the ring finger comes before the little finger; expected MANO's order index, middle, "
                        "little, ring, thumb")


def _array(content: dict[Any, Any], key: str, shape: tuple[int | None, ...], whole: bool = False) -> Array:
    """Entry `key` as finite float64, or int64 where `whole`, of `shape` (None: any length)."""
    if key not in content:
        names = ", ".join(str(k) for k in content if isinstance(k, str))[:300]
        raise DataError(f"lacks {key}; it has {names or 'nothing'}; {_GIVE}")
    value = _dense(_evaluated(content[key], key), key)
    fits = len(value.shape) == len(shape) and all(b in (None, a) for a, b in zip(value.shape, shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise DataError(f"{key} has shape {value.shape}; expected ({wanted})")
    if whole and value.dtype.kind not in "iu":
        raise DataError(f"{key} holds {value.dtype} numbers; expected whole ones")
    if not np.isfinite(value).all():
        raise DataError(f"{key} holds NaN or infinity; get the file again")
    # The bound also keeps a wider type of float from overflowing in the conversion to float64.
    if not whole and np.abs(value).max(initial=0.0) > 1e6:
        raise DataError(f"{key} holds values beyond 1e6; get the file again")
    return value.astype(np.int64 if whole else np.float64)


def _evaluated(value: Any, key: str) -> Any:
    """The array that a chumpy expression stands for; anything else unchanged."""
    chain: list[dict[str, Any]] = []
    while isinstance(value, _Chumpy):
        if len(chain) > 8 or not isinstance(getattr(value, "state", None), dict):
            raise DataError(f"{key} is a damaged chumpy expression; get the file again")
        if isinstance(value, _Select):
            chain.append(value.state)
            value = value.state.get("a")
        else:
            value = value.state.get("x")
    for state in reversed(chain):
        picked: Any = state.get("idxs")
        shape = state.get("preferred_shape")
        arrays = isinstance(value, np.ndarray) and isinstance(picked, np.ndarray)
        if not arrays or picked.dtype.kind not in "iu" or picked.size > 3 * MAX_VERTICES * MAX_SHAPES:
            raise DataError(f"{key} selects from no array; get the file again")
        flat = value.ravel()
        if picked.size and not (picked.min() >= 0 and picked.max() < flat.size):
            raise DataError(f"{key} selects entries that are not there; get the file again")
        value = flat[picked.ravel()]
        if isinstance(shape, tuple) and all(isinstance(n, int) and 0 < n < 2**31 for n in shape):
            value = value.reshape(shape)
    return value


def _dense(value: Any, key: str) -> Array:
    """An array unchanged, or a sparse matrix as a dense array."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return value
    if not isinstance(value, sparse.SparseStub):
        raise DataError(f"{key} is a {type(value).__name__.strip('_')}; expected an array of numbers")
    try:
        return sparse.dense(value, 16 * MAX_VERTICES)
    except DataError as error:
        raise DataError(f"{key} is a {error}; get the file again") from None
