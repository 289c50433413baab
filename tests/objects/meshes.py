"""Mesh files for the tests of added objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from dgrasp.types import Array

SIZE = (0.06, 0.05, 0.04)
VOLUME = 0.06 * 0.05 * 0.04


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
