"""Cut a solid into pieces whose convex hulls stay close to its surface.

Pieces are halved until no hull reaches far beyond the solid. Hulls are then merged, two at a time, while their common
hull stays within a tolerance. Distances of surfaces decide, not volumes, so thin walls and narrow holes count like
large ones, and it does not matter that scanned surfaces cut through themselves and enclose negative volumes.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from dgrasp.geometry.surface_distance import SampledSurface, surface_samples
from dgrasp.geometry.winding import winding_grid
from dgrasp.types import Array

_FINE, _MOST_PIECES = 0.7, 500
"""How far the pieces to be merged may reach, as a share of the tolerance, and how many there are at most, about."""
_MOST_POINTS = 500_000
"""Most points of the grid, about. Points are one tolerance apart, or more for an object that would take more."""
_ASKEW = np.array([0.137, 0.271, 0.393])
"""Share of the spacing by which the grid is shifted, so that no flat face lies along its points."""
_FIRST = 40
"""Points of a hull that are looked at first, about. Most hulls that reach too far do so at one of these."""
_THICKNESS = 1e-5
"""m. A hull is flat if its volume is less than this times its area."""
_WIDER = 1.1
"""Factor of the tolerance while there are too many hulls."""


@dataclass(frozen=True, eq=False)
class _Hull:
    """A convex hull: vertices (V, 3) m, faces (F, 3) in any winding, area (m^2) and volume (m^3)."""

    vertices: Array
    faces: Array
    area: float
    volume: float


def cut(solid: Any, tolerance: float, most: int) -> list[Array]:
    """The vertices (V, 3) m of at most `most` hulls that together hold a solid (a manifold, m).

    The surface of a hull reaches no farther than `tolerance` (m) beyond the solid, unless that takes more hulls; then
    the tolerance grows until there are few enough. There are no hulls of flat pieces.
    """
    space = _Space(solid, tolerance)
    hulls = _halved(solid, space, _FINE * tolerance)
    while True:
        hulls = _merged(hulls, space, tolerance)
        if len(hulls) <= most:
            return [hull.vertices for hull in hulls]
        tolerance *= _WIDER


class _Space:
    """A solid's surface, and a grid (X, Y, Z) bool that tells inside from outside."""

    def __init__(self, solid: Any, tolerance: float) -> None:
        vertices, faces = _triangles(solid)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        self.pitch = max(tolerance, float((np.prod(high - low) / _MOST_POINTS) ** (1.0 / 3.0)))
        self.low = low - self.pitch * _ASKEW
        counts = np.ceil((high - self.low) / self.pitch).astype(int) + 1
        size = (int(counts[0]), int(counts[1]), int(counts[2]))
        self.inside = winding_grid(vertices, faces, self.low, self.pitch, size) > 0
        self.surface = SampledSurface(vertices, faces, self.pitch)

    def reach(self, hull: _Hull, enough: float) -> float:
        """How far a hull's surface is beyond the solid, m; from `enough` on, this or less."""
        far = 0.0
        for spacing in ((hull.area / _FIRST) ** 0.5, self.pitch):
            points = surface_samples(hull.vertices, hull.faces, spacing)[0]
            nearest = np.rint((points - self.low) / self.pitch).astype(int).clip(0, np.array(self.inside.shape) - 1)
            outside = points[~self.inside[tuple(nearest.T)]]
            far = max(far, float(self.surface.distances(outside).max(initial=0.0)))
            if far > enough:
                break
        return far


def _triangles(solid: Any) -> tuple[Array, Array]:
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], order="C"), np.array(mesh.tri_verts, dtype=np.int64)


def _hull(points: Array) -> _Hull | None:
    """The hull of points (N, 3); None if it is flat."""
    try:
        made = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    if made.volume < _THICKNESS * made.area:
        return None
    numbers = np.zeros(len(points), dtype=np.int64)
    numbers[made.vertices] = np.arange(len(made.vertices))
    return _Hull(points[made.vertices], numbers[made.simplices], float(made.area), float(made.volume))


def _halved(solid: Any, space: _Space, tolerance: float) -> list[_Hull]:
    """Hulls of pieces within the tolerance, or `_MOST_PIECES`. The piece that reaches farthest is halved first."""
    done: list[_Hull] = []
    waiting: list[tuple[float, int, Any, _Hull]] = []
    number = itertools.count()

    def add(made: Any) -> None:
        for piece in made.decompose():
            hull = _hull(_triangles(piece)[0])
            if hull is None:
                continue
            reach = space.reach(hull, np.inf)
            if reach <= tolerance or np.ptp(hull.vertices, axis=0).max() < tolerance:
                done.append(hull)
            else:
                # Rounded, because equal values must be equal on every machine.
                heapq.heappush(waiting, (-round(reach, 7), next(number), piece, hull))

    add(solid)
    for _ in range(_MOST_PIECES):
        if not waiting or len(done) + len(waiting) >= _MOST_PIECES:
            break
        _, _, piece, hull = heapq.heappop(waiting)
        low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
        normal = np.eye(3)[int(np.argmax(high - low))]
        for half in piece.split_by_plane(tuple(normal.tolist()), float(normal @ (low + high)) / 2.0):
            add(half)
    return done + [hull for *_, hull in waiting]


def _merged(hulls: list[_Hull], space: _Space, tolerance: float) -> list[_Hull]:
    """Fewer hulls: while two have a common hull within the tolerance, the two that add the least volume become one."""
    alive = dict(enumerate(hulls))
    waiting: list[tuple[float, int, int, _Hull]] = []

    def consider(i: int, j: int) -> None:
        a, b = alive[i], alive[j]
        gaps = a.vertices.min(axis=0) - b.vertices.max(axis=0), b.vertices.min(axis=0) - a.vertices.max(axis=0)
        # With a wider gap, the middle of it is farther from the solid than the tolerance.
        hull = None if np.max(gaps) > 2.0 * tolerance else _hull(np.concatenate([a.vertices, b.vertices]))
        if hull is not None and space.reach(hull, tolerance) <= tolerance:
            heapq.heappush(waiting, (round(1e9 * (hull.volume - a.volume - b.volume), 3), i, j, hull))

    for i, j in itertools.combinations(alive, 2):
        consider(i, j)
    number = len(hulls)
    while waiting:
        _, i, j, hull = heapq.heappop(waiting)
        if i in alive and j in alive:
            del alive[i], alive[j]
            alive[number] = hull
            for k in list(alive):
                if k != number:
                    consider(k, number)
            number += 1
    return list(alive.values())
