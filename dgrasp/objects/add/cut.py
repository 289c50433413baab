"""Cut a solid into pieces whose convex hulls stay close to its surface.

A hull is too large where it holds space outside of the solid. Signed distances on a grid tell how far each such point
is from the solid. A piece is cut by the plane whose two sides have hulls with the least such space, until no hull
reaches more than a tolerance beyond the solid. Hulls whose common hull is still within the tolerance are then merged.
The grid decides, so it does not matter that scanned surfaces cut through themselves and enclose negative volumes.
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

PITCH, MOST_POINTS = 0.00125, 500_000
"""Least spacing of the grid's points, m, and most points; a larger object gets a wider spacing."""
_ASKEW = np.array([0.137, 0.271, 0.393])
"""Share of the spacing by which the grid is shifted, so that no flat face lies along its points."""
_NORMALS = np.array([n for n in itertools.product((-1.0, 0.0, 1.0), repeat=3) if n > (0.0, 0.0, 0.0)])
_NORMALS = _NORMALS[np.argsort(np.count_nonzero(_NORMALS, axis=1), kind="stable")]
"""Planes that are tried: along the axes, and askew to two or three of them."""
_NORMALS /= np.linalg.norm(_NORMALS, axis=1, keepdims=True)
_PLACES = 8
"""Intervals between the planes that are tried along each normal; the best planes are then moved by parts of one."""
_POINTS = 1500
"""Grid points by which planes are compared."""
_BALANCE = 0.05
"""Weight of the worse side. It decides while no plane is better, as with a ring: then the halves should be equal."""


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex hull: its vertices (V, 3) m, planes (F, 4) with normals outwards, and volume (m^3)."""

    vertices: Array
    planes: Array
    volume: float


def cut(solid: Any, tolerance: float, most: int) -> list[Array]:
    """The vertices (V, 3) m of at most `most` hulls that together hold a solid (a manifold, m).

    No hull reaches farther than `tolerance` (m) beyond the solid, as far as the grid sees and `most` allows.
    """
    pieces = cut_pieces(solid, tolerance, 2 * most)
    return [hull.vertices for hull in pieces]


class Space:
    """The space around a solid, as points of a grid: how far those in a hull are from the solid."""

    def __init__(self, solid: Any) -> None:
        vertices, faces = triangles(solid)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        self.pitch = max(PITCH, float((np.prod(high - low) / MOST_POINTS) ** (1.0 / 3.0)))
        self.low = low - self.pitch * _ASKEW
        counts = np.ceil((high - self.low) / self.pitch).astype(int) + 1
        size = (int(counts[0]), int(counts[1]), int(counts[2]))
        outside = np.nonzero(winding_grid(vertices, faces, self.low, self.pitch, size) <= 0)
        points = self.low + self.pitch * np.stack(outside, axis=1)
        hull = convex_hull(vertices)
        inside = within(hull.planes, points)
        self.values = np.zeros(size)
        self.values[tuple(axis[inside] for axis in outside)] = surface_distances(points[inside], vertices, faces, 0.001)

    def around(self, hull: Hull, least: float) -> tuple[Array, Array]:
        """Points (N, 3) in a hull that are more than `least` m away from the solid, and their distances (N,)."""
        low, pitch = self.low, self.pitch
        first = np.floor((hull.vertices.min(axis=0) - low) / pitch).astype(int).clip(0, None)
        last = np.ceil((hull.vertices.max(axis=0) - low) / pitch).astype(int) + 1
        values = self.values[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
        places = np.nonzero(values > least)
        points = low + pitch * (np.stack(places, axis=1) + first)
        inside = within(hull.planes, points)
        return points[inside], values[places][inside]


def triangles(solid: Any) -> tuple[Array, Array]:
    """Vertices (V, 3) m and faces (F, 3) of a manifold."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], order="C"), np.array(mesh.tri_verts, dtype=np.int64)


def within(planes: Array, points: Array) -> Array:
    """(N,) bool: which points (N, 3) are inside all planes (F, 4)."""
    inside = np.ones(len(points), dtype=bool)
    for some in np.array_split(planes, max(1, len(planes) // 16)):
        left = np.flatnonzero(inside)
        inside[left] = (points[left] @ some[:, :3].T + some[:, 3] <= 0.0).all(axis=1)
    return inside


def convex_hull(points: Array) -> Hull | None:
    """The hull of points (N, 3); None if it is flat."""
    try:
        made = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    return Hull(points[made.vertices], made.equations, float(made.volume))


class _Piece:
    """A connected piece of the solid, with its hull and the points in it that are outside of the solid."""

    def __init__(self, solid: Any, space: Space) -> None:
        self.solid = solid
        self.vertices, faces = triangles(solid)
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        self.edges = np.unique(edges, axis=0)
        self.hull = convex_hull(self.vertices)
        if self.hull is not None:
            self.points, self.depths = space.around(self.hull, 0.0)
            self.worst, self.cost = float(self.depths.max(initial=0.0)), float(self.depths.sum())


def cut_pieces(solid: Any, tolerance: float, most: int) -> list[Hull]:
    """Hulls of pieces, the most wrong ones cut first."""
    space = Space(solid)
    done: list[Hull] = []
    waiting: list[tuple[float, int, _Piece]] = []
    number = itertools.count()

    def add(made: Any) -> None:
        for part in made.decompose():
            piece = _Piece(part, space)
            if piece.hull is None:
                continue
            if piece.worst <= tolerance:
                done.append(piece.hull)
            else:
                heapq.heappush(waiting, (-round(piece.cost, 9), next(number), piece))

    add(solid)
    while waiting and len(done) + len(waiting) < most:
        piece = heapq.heappop(waiting)[2]
        normal, offset = _best_plane(piece)
        for half in piece.solid.split_by_plane(tuple(normal.tolist()), offset):
            add(half)
    hulls = done + [piece.hull for _, _, piece in waiting]
    n = len(hulls)
    while True:
        hulls = merge(hulls, space, tolerance)
        if len(hulls) <= most // 2:
            break
        tolerance *= 1.25
    print("pieces", n, "merged", len(hulls), "tolerance", tolerance)
    return hulls


def _best_plane(piece: _Piece) -> tuple[Array, float]:
    """Normal and offset of the plane whose sides have hulls with the least space outside of the solid."""
    step = max(1, len(piece.points) // _POINTS)
    points, depths = piece.points[::step], piece.depths[::step]
    tried: list[tuple[float, int, float, float]] = []
    for k, normal in enumerate(_NORMALS):
        heights = piece.vertices @ normal
        low, high = float(heights.min()), float(heights.max())
        width = (high - low) / _PLACES
        for j in range(1, _PLACES):
            offset = low + j * width
            tried.append((_cost(piece, normal, offset, points, depths), k, offset, width))
    tried.sort()
    best = tried[0][:3]
    for cost, k, middle, width in tried[:3]:
        for share in (0.5, 0.25, 0.125):
            start = middle
            for offset in (start - share * width, start + share * width):
                moved = _cost(piece, _NORMALS[k], offset, points, depths)
                if moved < cost:
                    cost, middle = moved, offset
        best = min(best, (cost, k, middle))
    return _NORMALS[best[1]], best[2]


def _cost(piece: _Piece, normal: Array, offset: float, points: Array, depths: Array) -> float:
    """The distances of the points that the hulls of both sides of a plane still hold."""
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
        anchors = np.where(side[one], one, other)
        kept = piece.edges[side[a] & side[b]]
        costs.append(_held(piece.vertices, side, kept, crossings, anchors, points[mine], depths[mine]))
    return round(sum(costs) + _BALANCE * max(costs), 9)


def _held(vertices: Array, side: Array, edges: Array, crossings: Array, anchors: Array, points: Array, depths: Array
          ) -> float:
    """The distances of the points in the hulls of the connected pieces on one side of a plane."""
    numbers = np.cumsum(side) - 1
    size = int(side.sum())
    links = coo_array((np.ones(len(edges), dtype=bool), tuple(numbers[edges].T)), shape=(size, size))
    count, label = connected_components(links, directed=False)
    corners = np.concatenate([vertices[side], crossings])
    label = np.concatenate([label, label[numbers[anchors]]])
    held = np.zeros(len(points), dtype=bool)
    for k in range(count):
        hull = convex_hull(corners[label == k])
        if hull is not None:
            left = np.flatnonzero(~held)
            held[left] = within(hull.planes, points[left])
    return float(depths[held].sum())


def merge(hulls: list[Hull], space: Space, tolerance: float) -> list[Hull]:
    """Fewer hulls: while two have a common hull within the tolerance, the two that add least volume become one."""
    alive = dict(enumerate(hulls))
    waiting: list[tuple[float, int, int, Hull]] = []

    def consider(i: int, j: int) -> None:
        a, b = alive[i], alive[j]
        gap = np.maximum(a.vertices.min(axis=0) - b.vertices.max(axis=0), b.vertices.min(axis=0) - a.vertices.max(axis=0))
        if gap.max() > 1e-4:
            return
        hull = convex_hull(np.concatenate([a.vertices, b.vertices]))
        if hull is not None and not len(space.around(hull, tolerance)[0]):
            heapq.heappush(waiting, (round(1e9 * (hull.volume - a.volume - b.volume), 3), i, j, hull))

    for i, j in itertools.combinations(alive, 2):
        consider(i, j)
    number = len(hulls)
    while waiting:
        _, i, j, hull = heapq.heappop(waiting)
        if i in alive and j in alive:
            del alive[i], alive[j]
            alive[number] = hull
            for k in [k for k in alive if k != number]:
                consider(k, number)
            number += 1
    return list(alive.values())
