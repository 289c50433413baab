"""The free hand's surface at the mean shape and zero pose: rings of vertices around palm and digits.

The palm is a tube of `LEVELS` rings around a lattice of 12 x 2 cells, three columns per finger. Each finger leaves its
end as a tube of ten-sided rings. The thumb leaves its side as a tube of twelve-sided rings. Each digit ends in one
vertex, the tip of the skeleton. By construction, the surface has no gap, one opening at the wrist, and rings where the
joints bend. It has 778 vertices, as MANO's has, with the tips at the indices of MANO's tips. `FINGER_RINGS` and
`THUMB_RINGS` place the outer rings. Palm and webs are drawn onto `dgrasp.hand.free.flesh` while their vertices spread
evenly.

Source: Pheasant, "Bodyspace", 2nd ed., 1996, hand dimensions of British adults, means of men and women: breadth and
thickness of index finger and thumb at the joints named below. The other fingers are scaled by the radii of
`dgrasp.hand.free.anatomy`. The profiles along the digits, and where the skin lies about the bones, are our own choice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dgrasp.hand.free.anatomy import (
    BONES,
    CARPAL_HEIGHT,
    RADII,
    THUMB_BASE,
    anatomical_axes,
    finger_direction,
    knuckles,
)
from dgrasp.hand.free.flesh import field, onto_surface, palm_flesh, web_reach
from dgrasp.hand.mano.model import MANO_TIPS
from dgrasp.hand.mano.skeleton import FINGERS
from dgrasp.types import Array

INDEX_BREADTH, INDEX_THICKNESS = 0.0195, 0.0175
"""m, of the index finger at its middle (PIP) joint."""
THUMB_BREADTH, THUMB_THICKNESS = 0.0210, 0.0200
"""m, of the thumb at its outer (IP) joint."""
CUT = 0.25 * CARPAL_HEIGHT
"""m, x of the opening: the crease of the wrist, at the radius."""
LEVELS, COLUMNS = 10, 12

Ring = tuple[int, float, float, float, float]
"""Bone (0 to 2), place along it (a share), breadth and thickness as shares of those measured above, and distance of the
middle from the bone towards the palm, in units of half the thickness there."""

FINGER_RINGS: tuple[Ring, ...] = (
    (0, 0.82, 0.985, 1.00, 0.08), (1, 0.00, 1.00, 1.00, 0.06), (1, 0.24, 0.965, 0.97, 0.08),
    (1, 0.75, 0.90, 0.895, 0.08), (2, 0.00, 0.895, 0.86, 0.06), (2, 0.28, 0.875, 0.84, 0.08),
    (2, 0.60, 0.815, 0.785, 0.10), (2, 0.83, 0.635, 0.61, 0.10), (2, 0.953, 0.36, 0.34, 0.06),
)  # fmt: skip
LITTLE_RINGS: tuple[Ring, ...] = (
    *FINGER_RINGS[:5], (2, 0.38, 0.86, 0.83, 0.08), (2, 0.74, 0.73, 0.70, 0.10), (2, 0.94, 0.40, 0.37, 0.06),
)  # fmt: skip
THUMB_RINGS: tuple[Ring, ...] = (
    (1, 0.22, 0.96, 1.00, 0.05), (1, 0.50, 0.93, 0.97, 0.05), (1, 0.80, 0.98, 0.97, 0.05), (2, 0.00, 1.00, 0.96, 0.05),
    (2, 0.22, 1.00, 0.92, 0.08), (2, 0.50, 0.96, 0.83, 0.11), (2, 0.75, 0.80, 0.68, 0.11), (2, 0.93, 0.46, 0.40, 0.06),
)  # fmt: skip
_THUMB_ROOTS = 4
"""Number of rings that are drawn onto the thumb's ball, between the palm and `THUMB_RINGS`."""
_THUMB_LEVELS = (2, 5)
_THUMB_CORNERS = ((12, 2), (12, 1), (12, 0), (11, 0))
"""The patch of the palm from which the thumb grows: between these levels, around the edge of palm and side."""
_THUMB_PHASE = 75.0
"""Angle around the thumb, degrees, of the patch's corner that is at the back and nearest to the wrist."""
_ROUNDS = 150

Quad = tuple[int, int, int, int]


@dataclass(frozen=True, eq=False)
class RingMesh:
    """vertices (V, 3) m, faces (F, 3) wound outwards, open at the wrist, tips (5,) vertices.

    digits (V, 5): 1 for the digit that a vertex belongs to, or halves for the two fingers that it lies between. A
    vertex of the palm belongs to the finger that it lies below, never to the thumb.
    """

    vertices: Array
    faces: Array
    digits: Array
    tips: Array


@dataclass(frozen=True, eq=False)
class Digit:
    """A straight digit: its first joint (3,) m, and unit vectors (3,) along, to the thumb's side and to the back.

    lengths: as in `anatomy.BONES`, m.
    """

    origin: Array
    along: Array
    side: Array
    back: Array
    lengths: tuple[float, float, float]

    def at(self, bone: int, share: float = 0.0) -> float:
        """m from the first joint to a share of a bone."""
        return sum(self.lengths[:bone]) + share * self.lengths[bone]


def digit(finger: str) -> Digit:
    """The digit at the zero pose; its side and back are those of the flexion of its two outer joints."""
    along = finger_direction(finger)
    origin = np.array(THUMB_BASE) if finger == "thumb" else knuckles()[finger]
    side = anatomical_axes(finger, 1, along)[2]
    return Digit(origin, along, side, np.cross(along, side), BONES[finger])


def ring_mesh() -> RingMesh:
    """Build the mesh; it is always the same."""
    builder = _Builder()
    palm = builder.palm()
    for finger in FINGERS[:4]:
        builder.finger(palm, finger)
    builder.thumb(palm)
    vertices = _drawn(builder)
    faces = np.array([*(t for quad in builder.quads for t in _halves(vertices, quad)), *builder.triangles])
    # The tips move to the indices of MANO's tips; all other vertices keep their order.
    tips = [builder.tips[finger] for finger in FINGERS]
    order = [i for i in range(len(vertices)) if i not in tips]
    for place, tip in zip(MANO_TIPS["right"], tips, strict=True):
        order.insert(place, tip)
    return RingMesh(vertices[order], np.argsort(order)[faces], np.array(builder.digits)[order],
                    np.array(MANO_TIPS["right"]))


class _Builder:
    """The mesh as it grows from the wrist to the tips. free: vertices that are still to be drawn onto the flesh."""

    def __init__(self) -> None:
        self.points: list[Array] = []
        self.free: list[bool] = []
        self.digits: list[Array] = []
        self.quads: list[Quad] = []
        self.triangles: list[tuple[int, int, int]] = []
        self.tips: dict[str, int] = {}

    def palm(self) -> dict[tuple[int, int, int], int]:
        """Add the palm's tube.

        Returns each vertex's index by level, column (0 is the little finger's side) and row (0 is the palm's side).
        """
        around, web = _around(0, COLUMNS), _web_line()
        first, last = _THUMB_LEVELS
        places = [(i, *p) for i in range(LEVELS) for p in around
                  if not (first < i < last and p in _THUMB_CORNERS[1:3])]  # fmt: skip
        places += [(LEVELS - 1, column, 1) for column in (3, 6, 9)]
        for level, column, row in places:
            u = level / (LEVELS - 1)
            wrist = np.array([CUT, 0.0, 0.028 * (2.0 * column / COLUMNS - 1.0)])
            point = (1.0 - u) * wrist + u * web[column]
            height = (-0.014, -0.003, 0.010)[row] * (0.6 if column in (0, COLUMNS) else 1.0)
            point[1] = -0.003 + height * (1.0 - 0.25 * u)
            block, inner = divmod(min(column, COLUMNS - 1), 3)
            share = np.eye(5)[3 - block]
            if inner == 0 and block:
                share = (share + np.eye(5)[4 - block]) / 2.0
            self._add([point], share, free=True)
        number = {place: i for i, place in enumerate(places)}
        patch = {around.index(corner) for corner in _THUMB_CORNERS[1:]}
        for i in range(LEVELS - 1):
            for m, (here, after) in enumerate(zip(around, around[1:] + around[:1], strict=True)):
                if not (first <= i < last and m in patch):
                    corners = [(i, *here), (i, *after), (i + 1, *after), (i + 1, *here)]
                    self.quads.append((number[corners[0]], number[corners[1]], number[corners[2]], number[corners[3]]))
        return number

    def finger(self, palm: dict[tuple[int, int, int], int], finger: str) -> None:
        """Add a finger's tube from the palm's end to its tip."""
        index = FINGERS.index(finger)
        column = 3 * (3 - index)
        ring = [palm[LEVELS - 1, c, row] for c, row in _around(column, column + 3)]
        rings = LITTLE_RINGS if finger == "little" else FINGER_RINGS
        self._tube(ring, finger, rings, np.radians(36.0 * np.arange(10)), *_halves_of(finger))

    def thumb(self, palm: dict[tuple[int, int, int], int]) -> None:
        """Add the thumb's tube from its patch to its tip."""
        a, b = _THUMB_LEVELS
        back, side, edge, inner = _THUMB_CORNERS
        loop = [*((i, *back) for i in range(a, b + 1)), (b, *side), (b, *edge),
                *((i, *inner) for i in range(b, a - 1, -1)), (a, *edge), (a, *side)]  # fmt: skip
        ring = [palm[place] for place in loop]
        angles = np.radians(_THUMB_PHASE + 30.0 * np.arange(12))
        start = np.array([self.points[i] for i in ring])
        end = _ring(digit("thumb"), THUMB_RINGS[0], angles, *_halves_of("thumb"))
        for k in range(_THUMB_ROOTS):
            share = (k + 1) / (_THUMB_ROOTS + 1)
            ring = self._join(ring, self._add((1.0 - share) * start + share * end, np.eye(5)[4], free=True))
        self._tube(ring, "thumb", THUMB_RINGS, angles, *_halves_of("thumb"))

    def _tube(
        self, ring: list[int], finger: str, rings: tuple[Ring, ...], angles: Array, breadth: float, thickness: float
    ) -> None:
        own, which = digit(finger), np.eye(5)[FINGERS.index(finger)]
        for entry in rings:
            ring = self._join(ring, self._add(_ring(own, entry, angles, breadth, thickness), which))
        (tip,) = self._add([own.origin + own.at(2, 1.0) * own.along], which)
        self.triangles += [(a, b, tip) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
        self.tips[finger] = tip

    def _add(self, points: list[Array] | Array, share: Array, free: bool = False) -> list[int]:
        first = len(self.points)
        self.points += list(points)
        count = len(self.points) - first
        self.free += [free] * count
        self.digits += [share] * count
        return list(range(first, first + count))

    def _join(self, ring: list[int], following: list[int]) -> list[int]:
        n = len(ring)
        self.quads += [(ring[m], ring[(m + 1) % n], following[(m + 1) % n], following[m]) for m in range(n)]
        return following


def _around(low: int, high: int) -> list[tuple[int, int]]:
    """(column, row) around a block of columns of the lattice, counter-clockwise as seen from the fingertips."""
    back = [(column, 2) for column in range(high, low - 1, -1)]
    return [(high, 1), *back, (low, 1), *((column, 0) for column in range(low, high + 1))]


def _halves_of(finger: str) -> tuple[float, float]:
    """Half the breadth and half the thickness, m: the units of the rings."""
    if finger == "thumb":
        return THUMB_BREADTH / 2, THUMB_THICKNESS / 2
    size = RADII[finger][1] / RADII["index"][1]
    return size * INDEX_BREADTH / 2, size * INDEX_THICKNESS / 2


def _ring(own: Digit, ring: Ring, angles: Array, breadth: float, thickness: float) -> Array:
    bone, share, broad, thick, drop = ring
    center = own.origin + own.at(bone, share) * own.along - drop * thick * thickness * own.back
    return np.asarray(center + broad * breadth * np.cos(angles)[:, None] * own.side
                      + thick * thickness * np.sin(angles)[:, None] * own.back)  # fmt: skip


def _web_line() -> Array:
    """(13, 3) m: where the palm's columns end."""
    line, count = np.zeros((COLUMNS + 1, 3)), np.zeros((COLUMNS + 1, 1))
    for index, finger in enumerate(FINGERS[:4]):
        own, half = digit(finger), _halves_of(finger)[0]
        for k in range(4):
            column, across = 3 * (3 - index) + k, (2.0 * k / 3.0 - 1.0) * half
            line[column] += own.origin + web_reach(finger) * own.along + across * own.side
            count[column] += 1.0
    return np.asarray(line / count)


def _drawn(builder: _Builder) -> Array:
    """(V, 3) m: all vertices, the free ones spread evenly on the flesh, and those of the opening in its plane."""
    points, free = np.array(builder.points), np.flatnonzero(builder.free)
    pairs = np.concatenate(
        [np.stack([face, np.roll(face, -1)], axis=1) for face in (*builder.quads, *builder.triangles)]
    )
    edges = np.unique(np.sort(pairs, axis=1), axis=0)
    moves = np.ones((len(free), 3))
    moves[points[free, 0] == CUT, 0] = 0.0
    bodies = palm_flesh()
    for _ in range(_ROUNDS):
        # Long edges pull more than short ones; otherwise the rings would slip to the narrow end of a cone.
        span = points[edges[:, 1]] - points[edges[:, 0]]
        pull = np.linalg.norm(span, axis=1, keepdims=True)
        total, weight = np.zeros_like(points), np.zeros((len(points), 1))
        for end, sign in ((0, 1.0), (1, -1.0)):
            np.add.at(total, edges[:, end], sign * pull * span)
            np.add.at(weight, edges[:, end], pull)
        step = (total / weight)[free] * moves
        normal = field(points[free], bodies)[1] * moves
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        step -= normal * (step * normal).sum(axis=1, keepdims=True)
        points[free] = onto_surface(points[free] + 0.5 * step, bodies, moves, 1)
    points[free] = onto_surface(points[free], bodies, moves, 6)
    return points


def _halves(points: Array, quad: Quad) -> list[tuple[int, int, int]]:
    """Two triangles along the shorter diagonal. The margin keeps rounding from deciding between equal ones."""
    a, b, c, d = quad
    if math.dist(points[a], points[c]) <= 1.02 * math.dist(points[b], points[d]):
        return [(a, b, c), (a, c, d)]
    return [(b, c, d), (b, d, a)]
