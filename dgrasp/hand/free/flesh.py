"""The flesh of the free hand's palm and of the roots of its digits: a field that is negative inside.

A smooth union of tapered, flattened capsules along bones and muscles, in the wrist frame of `dgrasp.hand.free.anatomy`
at its zero pose: carpus, metacarpals and the pads in front of them, the balls of thumb and little finger, the first
phalanges, and the webs between the digits. That module places the bones. The thickness of the flesh on them was chosen
such that the palm is as thick as published (`dgrasp.hand.free.rings` names the source).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dgrasp.hand.free.anatomy import (
    BONES,
    CARPAL_HEIGHT,
    METACARPAL_BASES,
    RADII,
    THUMB_BASE,
    finger_direction,
    knuckles,
)
from dgrasp.types import Array

BLEND = 0.003
"""m over which neighbouring bodies blend into each other."""
WEB_SHARE = 0.44
"""Where the webs between the fingers end, as a share of the first phalanx."""

_BACK = np.array([0.0, 1.0, 0.0])
"""Towards the back of the hand."""


@dataclass(frozen=True, eq=False)
class Flesh:
    """A tapered capsule from start to end, (3,) m each.

    radii: half breadths at start and end, m. ratio: thickness towards the hand's back, per breadth.
    """

    start: Array
    end: Array
    radii: tuple[float, float]
    ratio: float = 1.0


def palm_flesh() -> tuple[Flesh, ...]:
    """The bodies of the mean hand."""
    heads, base_x = knuckles(), -0.75 * CARPAL_HEIGHT
    bodies = [
        # The forearm's end with the carpus; the ball of the little finger.
        Flesh(np.array([0.030, -0.003, 0.0]), np.array([-0.026, -0.004, 0.002]), (0.0265, 0.0290), 0.62),
        Flesh(np.array([-0.016, -0.013, -0.020]), np.array([-0.066, -0.013, -0.0315]), (0.0120, 0.0095)),
    ]
    for finger, (x, z) in METACARPAL_BASES.items():
        base, head, size = np.array([base_x + x, 0.0, z]), heads[finger], RADII[finger][0] / RADII["index"][0]
        end = head + BONES[finger][0] * finger_direction(finger)
        bodies += [
            # The metacarpal under the back's skin, the pad in front of it, the first phalanx.
            Flesh(_by(base, 0.0, -0.001, 0.0), head, (0.0090, 0.0096 * size)),
            Flesh(_by(base, -0.020, -0.009, 0.0), _by(head, 0.003, -0.0125, 0.0), (0.0055, 0.0094 * size)),
            Flesh(_by(head, 0.0, -0.0025, 0.0), _by(end, 0.0, -0.001, 0.0), (0.0092 * size, 0.0086 * size)),
        ]
    for pair in pairwise(heads):
        # A web lies between the fingers' roots, on the palm's side.
        start, end = (_by(heads[f] + (web_reach(f) - 0.0055) * finger_direction(f), 0.0, -0.0045, 0.0) for f in pair)
        bodies.append(Flesh(start, end, (0.0050, 0.0050), 1.1))
    thumb, base, lengths = finger_direction("thumb"), np.array(THUMB_BASE), BONES["thumb"]
    joint = base + lengths[0] * thumb
    bodies += [
        # The thumb's metacarpal with its ball, its first phalanx, the short flexor beside them, and the first web.
        Flesh(_by(base, 0.006, 0.001, -0.006), joint, (0.0135, 0.0092)),
        Flesh(joint, joint + lengths[1] * thumb, (0.0095, 0.0096)),
        Flesh(_by(base, 0.002, -0.003, -0.010), _by(base + 0.75 * lengths[0] * thumb, -0.004, -0.001, -0.008),
              (0.0125, 0.0105)),
        Flesh(_by(base + 0.72 * lengths[0] * thumb, -0.004, 0.003, -0.006), _by(heads["index"], 0.020, -0.006, 0.004),
              (0.0060, 0.0060), 0.9),
    ]  # fmt: skip
    return tuple(bodies)


def _by(point: Array, x: float, y: float, z: float) -> Array:
    return np.asarray(point + np.array([x, y, z]))


def web_reach(finger: str) -> float:
    """m from the knuckle along the finger to the place where its skin leaves the palm's."""
    return WEB_SHARE * BONES[finger][0]


def field(points: Array, bodies: Sequence[Flesh]) -> tuple[Array, Array]:
    """Values (N,) m and gradients (N, 3) at points (N, 3): roughly the distance from the surface, negative inside."""
    parts = [_distance(points, body) for body in bodies]
    far, slopes = np.stack([value for value, _ in parts]), np.stack([slope for _, slope in parts])
    nearest = far.min(axis=0)
    shares = np.exp((nearest - far) / BLEND)
    total = shares.sum(axis=0)
    return nearest - BLEND * np.log(total), np.einsum("bn,bnk->nk", shares / total, slopes)


def onto_surface(points: Array, bodies: Sequence[Flesh], moves: Array, steps: int) -> Array:
    """Points (N, 3) after Newton steps to the surface; moves (N, 3): 0 for coordinates that stay, else 1."""
    for _ in range(steps):
        value, slope = field(points, bodies)
        slope = slope * moves
        # The lower bound keeps a point that can hardly move from jumping.
        points = points - value[:, None] * slope / np.maximum((slope**2).sum(axis=1, keepdims=True), 0.05)
    return points


def _distance(points: Array, body: Flesh) -> tuple[Array, Array]:
    """The field of one body and its gradient. A flattened body is measured as if it were round."""
    stretch = np.eye(3) + (1.0 / body.ratio - 1.0) * np.outer(_BACK, _BACK)
    offset, bone = (points - body.start) @ stretch, stretch @ (body.end - body.start)
    taper = body.radii[1] - body.radii[0]
    raw = offset @ bone / (bone @ bone)
    along = np.clip(raw, 0.0, 1.0)
    away = offset - along[:, None] * bone
    length = np.linalg.norm(away, axis=1)
    slope = away / np.maximum(length, 1e-9)[:, None]
    slope = slope - np.where(raw == along, taper / (bone @ bone), 0.0)[:, None] * bone
    return length - (body.radii[0] + along * taper), slope @ stretch
