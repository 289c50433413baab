"""How often closed triangles wind around the points of a grid, which tells what is inside without mesh booleans."""

from __future__ import annotations

import numpy as np

from dgrasp.types import Array


def winding_grid(vertices: Array, faces: Array, low: Array, pitch: float, counts: tuple[int, int, int]) -> Array:
    """(X, Y, Z) int: winding numbers of the points low + pitch * (i, j, k); positive inside faces wound outwards.

    A ray runs along x through each column of points and counts the faces by which it enters minus those by which it
    leaves. Overlapping solids wind twice around what they share, so positive still means inside any of them. If a
    surface is not closed, some rays enter and never leave; `leaking_columns` counts them.
    """
    return _crossings(vertices, faces, low, pitch, counts)[:-1].cumsum(axis=0)


def leaking_columns(vertices: Array, faces: Array, low: Array, pitch: float, counts: tuple[int, int, int]) -> int:
    """How many rays along x enter more often than they leave, or the reverse: 0 for a closed surface.

    vertices (V, 3), faces (F, 3). low (3,), pitch, counts: the grid, as in `winding_grid`.
    """
    return int((_crossings(vertices, faces, low, pitch, counts).sum(axis=0) != 0).sum())


def _crossings(vertices: Array, faces: Array, low: Array, pitch: float, counts: tuple[int, int, int]) -> Array:
    """(X + 1, Y, Z): entries minus exits between each point and the one before it; the last layer is past the grid."""
    n_x, n_y, n_z = counts
    grid = (vertices - low) / pitch
    corners = grid[faces]
    # The columns within each triangle's own bounds, as pairs of triangle and column.
    first = np.ceil(corners[:, :, 1:].min(axis=1)).clip(0, None).astype(int)
    last = np.floor(corners[:, :, 1:].max(axis=1)).clip(None, [n_y - 1, n_z - 1]).astype(int)
    spans = (last - first + 1).clip(0, None)
    amount = spans.prod(axis=1)
    triangle = np.repeat(np.arange(len(faces)), amount)
    place = np.arange(len(triangle)) - np.repeat(amount.cumsum() - amount, amount)
    y = first[triangle, 0] + place // spans[triangle, 1]
    z = first[triangle, 1] + place % spans[triangle, 1]
    left = [_left_of(faces[triangle, k], faces[triangle, (k + 1) % 3], grid, y, z) for k in range(3)]
    # A face that is counter-clockwise when seen against x points along x, so the ray leaves through it.
    leaving = left[0] & left[1] & left[2]
    entering = ~(left[0] | left[1] | left[2])
    hit = leaving | entering
    x = _height(corners[triangle[hit]], y[hit], z[hit])
    before = np.ceil(x).clip(0, n_x).astype(int)
    flat = (before * n_y + y[hit]) * n_z + z[hit]
    crossings = np.bincount(flat, np.where(entering[hit], 1, -1), (n_x + 1) * n_y * n_z)
    return np.asarray(np.rint(crossings).astype(int).reshape(n_x + 1, n_y, n_z))


def _left_of(start: Array, end: Array, grid: Array, y: Array, z: Array) -> Array:
    """(P,) bool: whether the points are left of the edges, seen against x.

    Computed for both faces of an edge by the same operations, so that no ray slips between them or meets both.
    """
    swapped = start > end
    a, b = grid[np.where(swapped, end, start)], grid[np.where(swapped, start, end)]
    side = (b[:, 1] - a[:, 1]) * (z - a[:, 2]) - (b[:, 2] - a[:, 2]) * (y - a[:, 1]) >= 0.0
    return np.asarray(side != swapped)


def _height(corners: Array, y: Array, z: Array) -> Array:
    """(P,): x where rays along x at (y, z) meet the triangles (P, 3, 3)."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1]
    safe = np.where(area == 0.0, 1.0, area)
    s = ((y - a[:, 1]) * v[:, 2] - (z - a[:, 2]) * v[:, 1]) / safe
    t = ((z - a[:, 2]) * u[:, 1] - (y - a[:, 1]) * u[:, 2]) / safe
    return np.asarray(a[:, 0] + s.clip(0, 1) * u[:, 0] + t.clip(0, 1) * v[:, 0])
