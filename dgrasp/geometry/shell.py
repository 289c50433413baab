"""A body's surface in cubes, and how much of it lies in another body, as grasp papers count penetration.

They cover the object's surface, not its inside, with cubes of 5 mm and count those whose centre is inside the hand. A
solid that the hand enters deeply therefore counts the same as a shell (docs/metrics.md).
"""

from __future__ import annotations

import numpy as np

from dgrasp.geometry.intersection import Body
from dgrasp.geometry.winding import winding_grid
from dgrasp.types import Array

CUBE = 0.005
"""Edge of the cubes, m."""


def surface_cubes(body: Body, edge: float = CUBE) -> Array:
    """(K, 3) int: the cubes that the body's surface passes through; cube k has its centre at edge * k."""
    import trimesh  # Imported late: it takes a second.

    vertices, faces = body.surface()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return np.asarray(np.rint(mesh.voxelized(edge).points / edge).astype(int))


def cubes_inside(cubes: Array, body: Body, edge: float = CUBE) -> float:
    """The volume (m^3) of those cubes (K, 3) whose centre is inside the body."""
    low, high = np.floor(body.bounds / edge).astype(int) + np.array([[0], [1]])
    mine = cubes[((cubes >= low) & (cubes <= high)).all(axis=1)]
    if not len(mine):
        return 0.0
    low, high = mine.min(axis=0), mine.max(axis=0)
    size = high - low + 1
    inside = winding_grid(body.vertices, body.faces, edge * low, edge, (int(size[0]), int(size[1]), int(size[2]))) > 0
    return float(inside[tuple((mine - low).T)].sum() * edge**3)
