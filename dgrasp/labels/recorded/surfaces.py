"""Objects' surfaces as points, to find which hand parts are near and whether an object is its own mirror image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.inertia import load_mesh
from dgrasp.hand.mano.skeleton import N_PARTS
from dgrasp.hand.spheres import CONTACT_DISTANCE
from dgrasp.labels.load import sha256_of
from dgrasp.objects.body import DETAILED_MESH
from dgrasp.objects.names import YCB_NAMES, resolve_object
from dgrasp.objects.store import MESH_FILE, NAME
from dgrasp.types import Array

MESHES = ("textured_simple.obj", DETAILED_MESH, MESH_FILE, "coacd/decomposed.obj")
"""An object's mesh in DexYCB's `models/NAME/`, the release's `objects/NAME/`, the folder of an object that `dgrasp
object add` wrote, and DexGraspNet's `meshdata/NAME/`, in the order of preference."""
NORMALISED = 0.5
"""m. A mesh that is longer, where a data set gives its scale, is of unit size and is multiplied by the scale."""
SPACING = 0.005
"""m. Edges of a mesh are halved until they are this short: the large faces of a box have no vertices of their own."""
MAX_POINTS, MAX_FILE_BYTES = 1_000_000, 64 * 2**20
MIRROR_TOLERANCE = 0.005
"""m. Largest distance between an object and its mirror image, over 99% of its surface."""


@dataclass(frozen=True, eq=False)
class Surface:
    """An object's surface: points (P, 3) m in its frame O, and a tree of them."""

    points: Array
    tree: Any

    def near_parts(self, vertices_O: Array, owner: Array) -> Array:
        """(16,) bool: the parts with a vertex within 0.015 m of the surface (supplement, section A.1).

        vertices_O: (V, 3) m, the hand's vertices in O. owner: (V,), the part that each moves with.
        """
        distance, _ = self.tree.query(vertices_O, distance_upper_bound=CONTACT_DISTANCE)
        near = np.zeros(N_PARTS, dtype=bool)
        near[owner[distance <= CONTACT_DISTANCE]] = True
        return near

    def mirror_plane(self) -> tuple[int, float, float]:
        """The best mirror plane across an axis of O: axis (0, 1, 2), its coordinate (m), and its deviation (m)."""
        best = (0, 0.0, np.inf)
        for axis in range(3):
            middle = float(self.points[:, axis].min() + self.points[:, axis].max()) / 2
            image = self.points.copy()
            image[:, axis] = 2.0 * middle - image[:, axis]
            off = float(np.quantile(self.tree.query(image)[0], 0.99))
            if off < best[2]:
                best = (axis, middle, off)
        return best


@dataclass
class Surfaces:
    """The objects' surfaces, each read when it is first asked for. folders: where NAME/ with a mesh is looked for.

    scale: of meshes of unit size, where a data set has them.
    """

    folders: Sequence[Path]
    scale: float | None = None
    _read: dict[str, Surface] = field(default_factory=dict)
    _hashes: dict[str, str] = field(default_factory=dict)

    def known(self, name: str) -> str:
        """The full name of one of the 20 objects, or of one with a mesh in the folders; else a `DataError`."""
        there = NAME.fullmatch(name) and any((Path(folder) / name / file).is_file() for folder in self.folders
                                             for file in MESHES)
        if there and name not in YCB_NAMES.values():
            return name
        try:
            return resolve_object(name)
        except DataError as error:
            raise DataError(f"{error}; an object of your own is looked for in "
                            f"{' and '.join(map(str, self.folders))}: add its mesh with `dgrasp object add`") from None

    def mesh(self, name: str) -> Path:
        """The object's mesh file. If there is none, raises `DataError` that says where it was looked for."""
        for folder in self.folders:
            for file in MESHES:
                if (Path(folder) / name / file).is_file():
                    return Path(folder) / name / file
        raise DataError(f"no mesh of {name}: expected {' or '.join(MESHES)} in NAME/ of "
                        f"{' or '.join(str(folder) for folder in self.folders)}; give the folder with --objects")

    def sha256(self, name: str) -> str:
        """The SHA-256 of the object's mesh file, in hexadecimal."""
        if name not in self._hashes:
            self._hashes[name] = sha256_of(self.mesh(name))
        return self._hashes[name]

    def __getitem__(self, name: str) -> Surface:
        if name not in self._read:
            self._read[name] = read_surface(self.mesh(name), self.scale)
        return self._read[name]


def read_surface(path: Path, scale: float | None = None) -> Surface:
    """The surface of a mesh file in m. scale: of a mesh of unit size (`NORMALISED`).

    Raises `DataError` for a damaged file, and for one in another unit."""
    import trimesh  # Late: it takes a second.
    from scipy.spatial import cKDTree

    if path.is_file() and path.stat().st_size > MAX_FILE_BYTES:
        raise DataError(f"{path}: {path.stat().st_size} bytes; a mesh has at most {MAX_FILE_BYTES}; simplify it")
    mesh = load_mesh(path)
    if scale is not None and float(np.ptp(np.asarray(mesh.vertices), axis=0).max()) > NORMALISED:
        mesh.apply_scale(scale)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    extent = float(np.ptp(vertices, axis=0).max())
    if not 0.005 <= extent <= 1.0:
        raise DataError(f"{path}: the object is {extent:g} long; expected 0.005 to 1 m; convert the mesh")
    if len(faces) > 4 * MAX_POINTS or float(mesh.area) / SPACING**2 > MAX_POINTS / 4:
        raise DataError(f"{path}: {len(faces)} faces of {float(mesh.area):g} m2; expected an object's surface; "
                        "simplify the mesh")
    dense, _ = trimesh.remesh.subdivide_to_size(vertices, faces, max_edge=SPACING, max_iter=20)
    points = np.unique(np.asarray(dense), axis=0)
    return Surface(points, cKDTree(points))
