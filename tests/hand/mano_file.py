"""A made-up hand in exactly MANO's layout, and its file: pickled byte by byte as Python 2 and chumpy do."""

from __future__ import annotations

import io
import pickle
import struct
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from dgrasp.types import Array

MANO_ORDER = ("index", "middle", "little", "ring", "thumb")
SPACING = np.array([0.0095, 0.011, 0.012])
"""m; the cells of the block hand along x (to the fingertips), y (thickness) and z (breadth)."""
COLUMNS = {"index": 6, "middle": 4, "little": 0, "ring": 2, "thumb": 8}
"""Cells of breadth: one per finger with a gap between; the little finger is on the side of -z."""
LENGTHS = {"index": 17, "middle": 18, "little": 15, "ring": 17, "thumb": 10}
JOINTS = {"index": (9, 13, 15), "middle": (9, 13, 15), "little": (9, 11, 13), "ring": (9, 13, 15), "thumb": (2, 5, 8)}
"""Planes of x, counted in cells from the wrist, where the fingers' joints lie."""


def _cells() -> set[tuple[int, int, int]]:
    """Occupied cells (x, y, z): palm, four fingers, and a thumb that leaves the palm near the wrist."""
    flat = {(x, z) for x in range(9) for z in range(7)} | {(x, 7) for x in range(1, 4)}
    for finger, column in COLUMNS.items():
        flat |= {(x, column) for x in range(1 if finger == "thumb" else 9, LENGTHS[finger])}
    return {(x, y, z) for x, z in flat for y in range(2)}


def _surface() -> tuple[Array, Array, Array]:
    """Vertices (V, 3) m, their places (V, 3) in cells, and faces (F, 3), open at the wrist (x = 0), wound outwards."""
    cells, corners, faces = _cells(), {}, []
    for cell in sorted(cells):
        for axis in range(3):
            for step in (0, 1):
                beyond = tuple(c + (2 * step - 1) * (k == axis) for k, c in enumerate(cell))
                if beyond in cells or beyond[0] < 0:
                    continue
                u, v = (k for k in range(3) if k != axis)
                ring = []
                for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    corner = list(cell)
                    corner[axis] += step
                    corner[u] += a
                    corner[v] += b
                    ring.append(corners.setdefault(tuple(corner), len(corners)))
                # (u, v, axis) is a right-handed triple for axes 0 and 2, and the sides at `step` 0 look the other way.
                ring = ring if (axis != 1) == (step == 1) else ring[::-1]
                faces += [[ring[0], ring[1], ring[2]], [ring[0], ring[2], ring[3]]]
    places = np.array(list(corners), dtype=float)
    # MANO's right hand: fingers along -x, thumb at +z, the wrist away from the origin.
    vertices = (places - [0.0, 1.0, 4.0]) * SPACING * [-1.0, 1.0, 1.0]
    return vertices, places, np.array(faces)[:, ::-1]


def _smoothed(vertices: Array, faces: Array, rounds: int = 2) -> Array:
    """Every vertex moved half-way to the mean of its neighbours, a few times: rounds the edges."""
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    for _ in range(rounds):
        total, count = np.zeros_like(vertices), np.zeros(len(vertices))
        for a, b in ((0, 1), (1, 0)):
            np.add.at(total, edges[:, a], vertices[edges[:, b]])
            np.add.at(count, edges[:, a], 1.0)
        vertices = 0.5 * vertices + 0.5 * total / count[:, None]
    return vertices


def _weights(places: Array) -> tuple[Array, list[Array]]:
    """Skinning weights (V, 16) that fade over a cell at each joint, and per joint the vertices next to it."""
    n = len(places)
    weights, near = np.zeros((n, 16)), [np.flatnonzero(places[:, 0] <= 1)]
    weights[:, 0] = 1.0
    for f, finger in enumerate(MANO_ORDER):
        column = COLUMNS[finger]
        mine = (places[:, 2] >= column) & (places[:, 2] <= column + 1)
        for s, plane in enumerate(JOINTS[finger]):
            joint = 1 + 3 * f + s
            share = np.where(mine, np.clip((places[:, 0] - plane + 0.75) / 1.5, 0.0, 1.0), 0.0)
            weights *= 1.0 - share[:, None]
            weights[:, joint] += share
            near.append(np.flatnonzero(mine & (np.abs(places[:, 0] - plane) <= 1)))
    return weights, near


def mano_arrays(seed: int = 0, n_shapes: int = 10, side: str = "right") -> dict[str, Array]:
    """The entries of a MANO file as plain arrays: at most 778 vertices, 16 joints, shapes, pose shapes, PCA."""
    rng = np.random.default_rng(seed)
    vertices, places, faces = _surface()
    vertices = _smoothed(vertices, faces) + np.array([0.095, 0.006, 0.006])
    weights, near = _weights(places)
    regressor = np.zeros((16, len(vertices)))
    for joint, around in enumerate(near):
        regressor[joint, around] = 1.0 / len(around)
    shapes = rng.normal(0.0, 2e-4, (len(vertices), 3, n_shapes))
    # The first component makes the hand larger, the second broader.
    shapes[:, :, 0] += 0.03 * (vertices - vertices.mean(axis=0))
    shapes[:, 2, 1] += 0.03 * (vertices[:, 2] - vertices[:, 2].mean())
    components = np.linalg.qr(rng.normal(size=(45, 45)))[0]
    arrays = {
        "v_template": vertices, "f": faces.astype(np.uint32), "weights": weights, "J_regressor": regressor,
        "shapedirs": shapes, "posedirs": rng.normal(0.0, 5e-4, (len(vertices), 3, 135)),
        "kintree_table": np.array([[2**32 - 1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14], range(16)]),
        "hands_mean": rng.normal(0.0, 0.2, 45), "hands_components": components,
        "hands_coeffs": rng.normal(size=(20, 45)), "J": regressor @ vertices,
    }
    if side == "left":
        for key in ("v_template", "shapedirs", "posedirs", "J"):
            arrays[key] = arrays[key].copy()
            arrays[key][:, 0] *= -1.0
        arrays["f"] = arrays["f"][:, ::-1].copy()
    return arrays


class Ch:
    """chumpy.ch.Ch as it is pickled: its attributes without caches."""

    def __init__(self, x: Array) -> None:
        self.__dict__.update(x=x, _dirty_vars={"x"}, _itr=None, _make_dense=False, _make_sparse=False,
                             _depends_on_deps={})


class Select:
    """chumpy.reordering.Select: entries of a flattened expression."""

    def __init__(self, a: Ch, idxs: Array, shape: tuple[int, ...]) -> None:
        self.__dict__.update(a=a, idxs=idxs, preferred_shape=shape, _dirty_vars={"a", "idxs", "preferred_shape"},
                             _itr=None, _make_dense=False, _make_sparse=False, _depends_on_deps={})


class Csc:
    """scipy.sparse.csc.csc_matrix of the time."""

    def __init__(self, dense: Array) -> None:
        matrix = sparse.csc_matrix(dense)
        self.__dict__.update(_shape=matrix.shape, maxprint=50, indices=matrix.indices, indptr=matrix.indptr,
                             data=matrix.data)


_GLOBALS = {
    Ch: ("chumpy.ch", "Ch"), Select: ("chumpy.reordering", "Select"), Csc: ("scipy.sparse.csc", "csc_matrix"),
    set: ("__builtin__", "set"),
}  # fmt: skip


class Python2Pickler(pickle._Pickler):
    """Protocol 2 as Python 2 wrote it: 8-bit strings, old module names, arrays by numpy's `_reconstruct`."""

    dispatch: ClassVar[dict[Any, Any]] = dict(pickle._Pickler.dispatch)

    def save_text(self, obj: str) -> None:
        self._string(obj.encode("latin1"))
        self.memoize(obj)

    dispatch[str] = save_text

    def _string(self, raw: bytes) -> None:
        self.write(b"U" + bytes([len(raw)]) + raw if len(raw) < 256 else b"T" + struct.pack("<I", len(raw)) + raw)

    def save(self, obj: Any, save_persistent_id: bool = True) -> None:
        if type(obj) in (Ch, Select, Csc):
            self._global(*_GLOBALS[type(obj)])
            self.write(b")\x81")
            self.save(vars(obj))
            self.write(b"b")
        elif type(obj) is set:
            self._global(*_GLOBALS[set])
            self.save((sorted(obj),))
            self.write(b"R")
        elif type(obj) is np.ndarray:
            self._array(obj)
        else:
            super().save(obj, save_persistent_id)

    def _global(self, module: str, name: str) -> None:
        self.write(f"c{module}\n{name}\n".encode())

    def _array(self, array: Array) -> None:
        self._global("numpy.core.multiarray", "_reconstruct")
        self._global("numpy", "ndarray")
        self.write(b"K\x00\x85U\x01b\x87R")
        fortran = array.flags.f_contiguous and not array.flags.c_contiguous
        self.write(b"(K\x01")
        self.save(tuple(array.shape))
        self._global("numpy", "dtype")
        order, code = array.dtype.str[:1].encode(), array.dtype.str[1:].encode()
        self.write(b"U\x02" + code + b"K\x00K\x01\x87R(K\x03U\x01" + order + b"NNN"
                   b"J\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb" + (b"\x88" if fortran else b"\x89"))
        self._string(array.tobytes("F" if fortran else "C"))
        self.write(b"tb")


def mano_content(arrays: dict[str, Array]) -> dict[str, Any]:
    """The dictionary of a MANO file: shapes selected from a longer basis, a sparse regressor, as MANO's are."""
    shapes = arrays["shapedirs"]
    longer = np.concatenate([shapes, np.ones_like(shapes)], axis=2)
    chosen = np.arange(longer.size).reshape(longer.shape)[:, :, : shapes.shape[2]].ravel()
    return {
        **arrays,
        "shapedirs": Select(Ch(longer), chosen, shapes.shape),
        "posedirs": np.asfortranarray(arrays["posedirs"]),
        "J_regressor": Csc(arrays["J_regressor"]),
        "bs_style": "lbs", "bs_type": "lrotmin",
    }  # fmt: skip


def pickled(content: Any) -> bytes:
    """`content` as Python 2 would pickle it."""
    stream = io.BytesIO()
    Python2Pickler(stream, protocol=2).dump(content)
    return stream.getvalue()


def write_mano(path: Path, arrays: dict[str, Array] | None = None) -> Path:
    """A MANO file of these arrays, or of the made-up right hand."""
    path.write_bytes(pickled(mano_content(mano_arrays() if arrays is None else arrays)))
    return path
