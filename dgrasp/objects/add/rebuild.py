"""Make a solid from triangles in any disorder, on a grid: cells that no path from outside reaches are inside.

Neither winding nor connections matter, and gaps narrower than a cell close. Walls thinner than two cells and all
cavities are lost, so this is the last resort of `repair`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dgrasp.types import Array

CELLS = 64
"""Cells along the longest side."""
_STEP = 1.5
"""Spacing, in cells, of the points from which the new surface is found."""
_EXPLAINED = 0.8
"""Smallest share of the surface cells that must be near an inside cell; with less, there is no real inside."""


@dataclass(frozen=True, eq=False)
class Rebuilt:
    """A manifold in m, and the edge (m) of the cells that it was made from; the surface is off by up to about one."""

    solid: Any
    pitch: float


def rebuild(vertices: Array, faces: Array) -> Rebuilt | None:
    """The solid within triangles (vertices (V, 3) m, faces (F, 3)); None if they have no inside."""
    import trimesh
    from manifold3d import Error, Manifold
    from scipy.ndimage import binary_fill_holes, distance_transform_edt

    pitch = float(np.ptp(vertices, axis=0).max()) / CELLS
    grid = trimesh.Trimesh(vertices, faces, process=False).voxelized(pitch)
    surface = np.pad(np.asarray(grid.matrix, dtype=bool), 3)
    first = np.asarray(grid.transform)[:3, 3] - 3 * pitch
    filled = binary_fill_holes(surface)
    inside = filled & ~surface
    if not inside.any():
        return None
    to_inside = distance_transform_edt(~inside)
    if (to_inside[surface] <= 2.0).mean() < _EXPLAINED:
        return None
    # Zero in the middle of the cells that the surface passes through.
    depth = distance_transform_edt(filled) - to_inside
    high = first + pitch * (np.array(depth.shape) - 1)
    solid = Manifold.level_set(_interpolated(depth, first, pitch), [*first, *high], _STEP * pitch, 0.0)
    if solid.status() != Error.NoError or solid.volume() <= 0.0:
        return None
    return Rebuilt(solid.simplify(pitch / 10), pitch)


def _interpolated(values: Array, first: Array, pitch: float) -> Any:
    """Linear interpolation between cells as a function of x, y, z (m)."""
    # Called some hundred thousand times, for one point each: plain lists are then several times faster than numpy.
    nx, ny, nz = values.shape
    flat = values.reshape(-1).tolist()
    ox, oy, oz = (float(v) for v in first)
    step = ny * nz

    def value(x: float, y: float, z: float) -> float:
        u, v, w = (x - ox) / pitch, (y - oy) / pitch, (z - oz) / pitch
        i, j, k = min(max(int(u), 0), nx - 2), min(max(int(v), 0), ny - 2), min(max(int(w), 0), nz - 2)
        u, v, w = u - i, v - j, w - k
        at = (i * ny + j) * nz + k
        low = (flat[at] * (1 - w) + flat[at + 1] * w) * (1 - v) + (flat[at + nz] * (1 - w) + flat[at + nz + 1] * w) * v
        at += step
        top = (flat[at] * (1 - w) + flat[at + 1] * w) * (1 - v) + (flat[at + nz] * (1 - w) + flat[at + nz + 1] * w) * v
        return float(low * (1 - u) + top * u)

    return value
