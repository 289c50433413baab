"""Mesh files for the tests of added objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from dgrasp.objects.add.mesh_reader import read_mesh_file
from dgrasp.objects.add.repair import repair
from dgrasp.types import Array

SIZE = (0.06, 0.05, 0.04)
VOLUME = 0.06 * 0.05 * 0.04
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
"""The faces of `corners`, wound outwards."""


Point = tuple[float, float, float]


def box(size: Point = SIZE, center: Point = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """A box of 12 faces."""
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(center))


def plain(vertices: Array, faces: Array) -> trimesh.Trimesh:
    """A mesh as it is, nothing merged."""
    return trimesh.Trimesh(vertices, faces, process=False)


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))


def save(mesh: trimesh.Trimesh, path: Path, scale: float = 1.0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    plain(np.asarray(mesh.vertices) * scale, mesh.faces).export(path)
    return path


def corners(size: tuple[float, float, float] = SIZE, center: tuple[float, float, float] = (0, 0, 0)) -> Array:
    """(8, 3) of a box."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return signs * np.array(size) / 2 + np.array(center)


def solid_volume(path: Path) -> float:
    read = read_mesh_file(path)
    return float(repair(read.vertices, read.faces).solid.volume())
