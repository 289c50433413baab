"""The closed mesh of one rigid part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.types import Array


@dataclass(frozen=True, eq=False)
class PartMesh:
    """A closed mesh, wound outwards: vertices (V, 3) m in the part's frame, faces (F, 3)."""

    name: str
    vertices: Array
    faces: Array

    @property
    def volume(self) -> float:
        """Enclosed volume, m^3."""
        return mesh_volume(self.vertices, self.faces)


def mesh_volume(vertices: Array, faces: Array) -> float:
    """Volume in m^3 that a closed mesh, wound outwards, encloses. vertices (V, 3) m, faces (F, 3)."""
    # Relative to a vertex of the mesh, because a distant origin would cost digits.
    a, b, c = np.moveaxis(vertices[faces] - vertices[faces[0, 0]], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6.0)
