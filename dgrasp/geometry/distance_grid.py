"""The signed distance to the closed surface of any mesh, computed once on a grid of points and then looked up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.geometry.intersection import Body
from dgrasp.geometry.winding import winding_grid
from dgrasp.types import Array

PITCH = 0.003
"""Spacing of the grid's points, m."""
MARGIN = 0.03
"""Margin of the grid around the surface's bounding box, m."""
MAX_POINTS = 500_000
"""Most points of a grid; for a larger object the pitch is increased."""
_NEAREST = 3
_ASKEW = np.array([0.137, 0.271, 0.393])
_FAR = 0.021
"""m. Beyond this distance the nearest sample stands for the surface."""


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distances, negative inside, on a grid in the body's frame.

    values: (X, Y, Z) m; values[i, j, k] is that of the point low + pitch * (i, j, k). low: (3,) m. pitch: m.
    """

    low: Array
    pitch: float
    values: Array

    @property
    def high(self) -> Array:
        """(3,) m: the last point of the grid."""
        return np.asarray(self.low + self.pitch * (np.array(self.values.shape) - 1))


def distance_grid(body: Body, pitch: float = PITCH, margin: float = MARGIN) -> DistanceGrid:
    """The grid of a body. Distances are exact up to 0.018 m; beyond, they are too large by less than a pitch.

    Inside a union of solids the distance is the depth below the union's surface, not below that of one solid.
    """
    import trimesh  # Imported late: it takes a second.
    from scipy.spatial import cKDTree

    vertices, faces = body.surface()
    low, high = vertices.min(axis=0) - margin, vertices.max(axis=0) + margin
    # This keeps the rays of the winding numbers from running along a face.
    low -= pitch * _ASKEW
    pitch = max(pitch, float((np.prod(high - low) / MAX_POINTS) ** (1 / 3)))
    counts = np.ceil((high - low) / pitch).astype(int) + 1
    size = (int(counts[0]), int(counts[1]), int(counts[2]))
    axes = [start + pitch * np.arange(n) for start, n in zip(low, size, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # Samples that are as dense as the grid lead to the nearest triangles.
    corners, pieces, owner = trimesh.remesh.subdivide_to_size(
        vertices, faces, max_edge=pitch, max_iter=20, return_index=True
    )
    far, near = cKDTree(corners[pieces].mean(axis=1)).query(points, k=min(_NEAREST, len(pieces)))
    far, near = far.reshape(len(points), -1), near.reshape(len(points), -1)
    distance, triangles = far[:, 0].copy(), vertices[faces]
    close = np.flatnonzero(distance < _FAR)
    for column in near[close].T:
        distance[close] = np.minimum(distance[close], triangle_distances(triangles[owner[column]], points[close]))
    values = distance.reshape(size)
    return DistanceGrid(low, pitch, np.where(_inside(vertices, faces, low, pitch, size), -values, values))


def _inside(vertices: Array, faces: Array, low: Array, pitch: float, size: tuple[int, int, int]) -> Array:
    """(X, Y, Z) bool, by vote of rays along the three axes: one may be wrong where it runs along a sliver."""
    votes = np.zeros(size, int)
    for axis in range(3):
        order = [axis, (axis + 1) % 3, (axis + 2) % 3]
        turned = (size[order[0]], size[order[1]], size[order[2]])
        winding = winding_grid(vertices[:, order], faces, low[order], pitch, turned)
        votes += (winding > 0).transpose(np.argsort(order))
    return votes >= 2


def triangle_distances(triangles: Array, points: Array) -> Array:
    """(P,) m: the distance of each point (P, 3) from its own triangle (P, 3, 3)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    squared = np.minimum(_edge(a, b, points), np.minimum(_edge(b, c, points), _edge(c, a, points)))
    u, v, w = b - a, c - a, points - a
    normal = np.cross(u, v)
    area = np.maximum((normal * normal).sum(axis=1), 1e-30)
    # Barycentric coordinates of the point's projection on the plane.
    s, t = (np.cross(w, v) * normal).sum(axis=1) / area, (np.cross(u, w) * normal).sum(axis=1) / area
    above = (w * normal).sum(axis=1) ** 2 / area
    within = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    return np.asarray(np.sqrt(np.where(within, np.minimum(squared, above), squared)))


def _edge(a: Array, b: Array, points: Array) -> Array:
    """(P,) m^2: squared distances of points from segments a to b."""
    along, offset = b - a, points - a
    share = (offset * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-30)
    gap = offset - share.clip(0.0, 1.0)[:, None] * along
    return np.asarray((gap * gap).sum(axis=1))
