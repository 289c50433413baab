"""Cut a solid into pieces whose convex hulls stay close to its surface.

A hull is too large where it holds space outside of the solid. Distances from the solid, on a grid, tell how far. A piece
is cut by the plane whose two sides have hulls with the least such space, until no hull reaches farther than a tolerance
beyond the solid. Hulls whose common hull is still within the tolerance are then merged. No volume is computed, so it
does not matter that scanned surfaces cut through themselves and enclose negative volumes.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from dgrasp.geometry.surface_distance import surface_distances
from dgrasp.geometry.winding import winding_grid
from dgrasp.types import Array

_PITCH, _MOST_POINTS = 0.8, 500_000
"""Spacing of the grid's points, as a share of the tolerance; wider for an object that needs more points than this."""
_ASKEW = np.array([0.137, 0.271, 0.393])
"""Share of the spacing by which the grid is shifted, so that no flat face lies along its points."""
_NORMALS = np.array([n for n in itertools.product((-1.0, 0.0, 1.0), repeat=3) if n > (0.0, 0.0, 0.0)])
_NORMALS = _NORMALS[np.argsort(np.count_nonzero(_NORMALS, axis=1), kind="stable")]
_NORMALS /= np.linalg.norm(_NORMALS, axis=1, keepdims=True)
"""Normals of the planes that are tried: the three axes, then the diagonals between two and three of them."""
_PLACES = 6
"""Intervals between the planes that are tried along each normal. The best planes are then moved by parts of one."""
_POINTS = 1000
"""Grid points by which planes are compared, about."""
_ROUGH = 0.4
"""Share of the tolerance by which the surface may move where planes are compared; few vertices make that quick."""
_BALANCE = 0.05
"""Weight of the worse side. It decides while no plane is better, as with a ring, whose halves should be equal."""
_WIDER = 1.1
"""Factor of the tolerance while there are too many hulls."""


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex hull: its vertices (V, 3) m, planes (F, 4) with normals outwards, and volume (m^3)."""

    vertices: Array
    planes: Array
    volume: float


def cut(solid: Any, tolerance: float, most: int) -> list[Array]:
    """The vertices (V, 3) m of at most `most` hulls that together hold a solid (a manifold, m).

    No hull reaches farther than `tolerance` (m) beyond the solid, as far as the grid shows, unless that takes more
    hulls; then the tolerance grows until there are few enough. There are no hulls of flat pieces.
    """
    space = _Space(solid, tolerance)
    hulls = _cut(solid, space, tolerance, 2 * most)
    while True:
        hulls = _merged(hulls, space, tolerance)
        if len(hulls) <= most:
            return [hull.vertices for hull in hulls]
        tolerance *= _WIDER


class _Space:
    """The space around a solid: points of a grid with their distances from it."""

    def __init__(self, solid: Any, tolerance: float) -> None:
        vertices, faces = _triangles(solid)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        self.pitch = max(_PITCH * tolerance, float((np.prod(high - low) / _MOST_POINTS) ** (1.0 / 3.0)))
        self.low = low - self.pitch * _ASKEW
        counts = np.ceil((high - self.low) / self.pitch).astype(int) + 1
        size = (int(counts[0]), int(counts[1]), int(counts[2]))
        # (X, Y, Z) m: the distance of each point; zero inside the solid, and outside of its hull, where no part reaches.
        self.distances = np.zeros(size)
        outside = np.nonzero(winding_grid(vertices, faces, self.low, self.pitch, size) <= 0)
        points = self.low + self.pitch * np.stack(outside, axis=1)
        hull = _hull(vertices)
        inside = np.zeros(len(points), dtype=bool) if hull is None else _within(hull.planes, points)
        far = surface_distances(points[inside], vertices, faces, self.pitch)
        self.distances[tuple(axis[inside] for axis in outside)] = far

    def held(self, hull: Hull, least: float) -> tuple[Array, Array]:
        """Points (N, 3) in a hull that are more than `least` m away from the solid, and their distances (N,)."""
        first = np.floor((hull.vertices.min(axis=0) - self.low) / self.pitch).astype(int).clip(0, None)
        last = np.ceil((hull.vertices.max(axis=0) - self.low) / self.pitch).astype(int) + 1
        near = self.distances[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
        places = np.nonzero(near > least)
        points = self.low + self.pitch * (np.stack(places, axis=1) + first)
        inside = _within(hull.planes, points)
        return points[inside], near[places][inside]


def _triangles(solid: Any) -> tuple[Array, Array]:
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], order="C"), np.array(mesh.tri_verts, dtype=np.int64)


def _hull(points: Array) -> Hull | None:
    """The hull of points (N, 3); None if it is flat."""
    try:
        made = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    return Hull(points[made.vertices], made.equations, float(made.volume))


def _within(planes: Array, points: Array) -> Array:
    """(N,) bool: which points (N, 3) are inside all planes (F, 4)."""
    inside = np.ones(len(points), dtype=bool)
    for some in np.array_split(planes, 1 + len(planes) // 64):
        left = np.flatnonzero(inside)
        inside[left] = (points[left] @ some[:, :3].T + some[:, 3]).max(axis=1) <= 0.0
    return inside


class _Piece:
    """A connected piece of the solid: its surface, its hull, and the points that the hull holds in vain."""

    def __init__(self, solid: Any, hull: Hull, space: _Space, slack: float) -> None:
        self.solid, self.hull = solid, hull
        rough = solid.simplify(slack)
        self.vertices, faces = _triangles(solid if rough.is_empty() else rough)
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        self.edges = edges[edges[:, 0] < edges[:, 1]]
        self.points, self.distances = space.held(hull, 0.0)
        self.cost = round(float(self.distances.sum()), 9)


def _cut(solid: Any, space: _Space, tolerance: float, most: int) -> list[Hull]:
    """Hulls of pieces within the tolerance, or `most` hulls and a few. The piece with the worst hull is cut first."""
    done: list[Hull] = []
    waiting: list[tuple[float, int, _Piece]] = []
    number = itertools.count()

    def add(made: Any) -> None:
        for part in made.decompose():
            hull = _hull(_triangles(part)[0])
            if hull is None:
                continue
            piece = _Piece(part, hull, space, _ROUGH * tolerance)
            if piece.distances.max(initial=0.0) <= tolerance:
                done.append(hull)
            else:
                heapq.heappush(waiting, (-piece.cost, next(number), piece))

    add(solid)
    while waiting and len(done) + len(waiting) < most:
        piece = heapq.heappop(waiting)[2]
        normal, offset = _best_plane(piece)
        for half in piece.solid.split_by_plane(tuple(normal.tolist()), offset):
            add(half)
    return done + [piece.hull for _, _, piece in waiting]


def _best_plane(piece: _Piece) -> tuple[Array, float]:
    """Normal (3,) and offset (m) of the plane of the least cost among those that are tried."""
    step = max(1, len(piece.points) // _POINTS)
    points, distances = piece.points[::step], piece.distances[::step]
    tried: list[tuple[float, int, float, float]] = []
    for k, normal in enumerate(_NORMALS):
        heights = piece.vertices @ normal
        low, high = float(heights.min()), float(heights.max())
        width = (high - low) / _PLACES
        for j in range(1, _PLACES):
            offset = low + j * width
            tried.append((_cost(piece, normal, offset, points, distances), k, offset, width))
    tried.sort()
    best = tried[0][:3]
    for cost, k, middle, width in tried[:3]:
        for share in (0.5, 0.25, 0.125):
            start = middle
            for offset in (start - share * width, start + share * width):
                moved = _cost(piece, _NORMALS[k], offset, points, distances)
                if moved < cost:
                    cost, middle = moved, offset
        best = min(best, (cost, k, middle))
    return _NORMALS[best[1]], best[2]


def _cost(piece: _Piece, normal: Array, offset: float, points: Array, distances: Array) -> float:
    """The sum of the distances of the points that the hulls on both sides of a plane still hold, and `_BALANCE`.

    points (N, 3), distances (N,): those of the piece, or some of them. The cost is rounded, because equal costs must
    be equal on every machine; then the first plane is taken.
    """
    heights = piece.vertices @ normal - offset
    above = heights > 0.0
    a, b = piece.edges.T
    crossed = above[a] != above[b]
    one, other = a[crossed], b[crossed]
    share = heights[one] / (heights[one] - heights[other])
    crossings = piece.vertices[one] + share[:, None] * (piece.vertices[other] - piece.vertices[one])
    higher = points @ normal > offset
    costs = []
    for side, mine in ((above, higher), (~above, ~higher)):
        if not side.any():
            return np.inf
        corners = np.concatenate([piece.vertices[side], crossings])
        label = _connected(side, piece.edges, np.where(side[one], one, other))
        left, cost = np.flatnonzero(mine), 0.0
        for k in range(label.max() + 1):
            hull = _hull(corners[label == k])
            if hull is not None:
                inside = _within(hull.planes, points[left])
                cost += float(distances[left[inside]].sum())
                left = left[~inside]
        costs.append(cost)
    return round(sum(costs) + _BALANCE * max(costs), 9)


def _connected(side: Array, edges: Array, anchors: Array) -> Array:
    """The connected piece of each vertex on one side of a plane (V,) bool, then of each crossing, by its vertex."""
    numbers = np.cumsum(side) - 1
    kept = numbers[edges[side[edges].all(axis=1)]]
    size = int(side.sum())
    links = coo_array((np.ones(len(kept), dtype=bool), (kept[:, 0], kept[:, 1])), shape=(size, size))
    label = connected_components(links, directed=False)[1]
    return np.concatenate([label, label[numbers[anchors]]])


def _merged(hulls: list[Hull], space: _Space, tolerance: float) -> list[Hull]:
    """Fewer hulls: while two have a common hull within the tolerance, the two that add the least volume become one."""
    alive = dict(enumerate(hulls))
    waiting: list[tuple[float, int, int, Hull]] = []

    def consider(i: int, j: int) -> None:
        a, b = alive[i], alive[j]
        gaps = a.vertices.min(axis=0) - b.vertices.max(axis=0), b.vertices.min(axis=0) - a.vertices.max(axis=0)
        # With a wider gap, the middle of it is farther from the solid than the tolerance.
        hull = None if np.max(gaps) > 2.0 * tolerance else _hull(np.concatenate([a.vertices, b.vertices]))
        if hull is not None and not len(space.held(hull, tolerance)[0]):
            # In mm3, rounded as the costs are.
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
