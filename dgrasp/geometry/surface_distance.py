"""Points spread over a surface, and the distance of points from it."""

from __future__ import annotations

import numpy as np

from dgrasp.geometry.distance_grid import triangle_distances
from dgrasp.types import Array

_GOLDEN = 1.0 / 1.324717957244746 ** np.arange(1, 3)
"""Multiples of these, modulo 1, spread evenly over a square."""


def surface_samples(vertices: Array, faces: Array, spacing: float) -> tuple[Array, Array]:
    """Points (N, 3) all over the triangles, about one per `spacing` (m) squared, and the face of each (N,).

    vertices (V, 3) m, faces (F, 3). Each face gets its share by area, at least one point. The same surface gives the
    same points.
    """
    a = vertices[faces[:, 0]]
    u, v = vertices[faces[:, 1]] - a, vertices[faces[:, 2]] - a
    areas = np.linalg.norm(np.cross(u, v), axis=1) / 2.0
    counts = np.ceil(areas / spacing**2).astype(int).clip(1, None)
    owner = np.repeat(np.arange(len(faces)), counts)
    place = np.arange(len(owner)) - np.repeat(counts.cumsum() - counts, counts)
    s, t = ((0.5 + np.outer(place, _GOLDEN)) % 1.0).T
    beyond = s + t > 1.0
    s, t = np.where(beyond, 1.0 - s, s), np.where(beyond, 1.0 - t, t)
    return a[owner] + s[:, None] * u[owner] + t[:, None] * v[owner], owner


class SampledSurface:
    """Triangles that distances are measured from: vertices (V, 3) m, faces (F, 3).

    Points near the surface are measured against the faces of the three nearest of samples `spacing` m apart, points
    farther than four times that against the nearest sample. A distance may be too large by a fraction of the spacing;
    it is never too small.
    """

    def __init__(self, vertices: Array, faces: Array, spacing: float) -> None:
        from scipy.spatial import cKDTree

        self.spacing, self.triangles = spacing, vertices[faces]
        samples, self.owner = surface_samples(vertices, faces, spacing)
        self.tree = cKDTree(samples)

    def distances(self, points: Array) -> Array:
        """(N,) m: the distances of points (N, 3)."""
        if not len(points):
            return np.zeros(0)
        far, near = self.tree.query(points, k=[1, 2, 3] if self.tree.n > 2 else [1])
        distances = far[:, 0].copy()
        close = np.flatnonzero(distances < 4.0 * self.spacing)
        for column in near[close].T:
            found = triangle_distances(self.triangles[self.owner[column]], points[close])
            distances[close] = np.minimum(distances[close], found)
        return np.asarray(distances)
