"""What round bodies need to rest and to roll as they should in PyBullet (docs/physics.md, "Rest").

Bullet keeps the contact points of earlier steps and finds one new point per pair of convex shapes and step. Where a bar
rolls, the new point is at one end, and an old point, which has turned with the bar, carries the other. It lies behind
the bar's centre, so the bar's weight tips it forwards. Without error reduction the bar also sinks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from raisim_like.engines.body_frame import BodyFrame
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape

BREAKING_THRESHOLD = 0.005
"""Bullet multiplies it by a shape's radius. At 0.001 a standing can drops the point that it rocks away from."""
ROLLING_FRICTION = 2e-5
"""m, between round and static bodies: contact points, found to some micrometres, may be that far from their places."""
ROLLING_FRICTION_OF_FACES = 1e-4
"""m, the same for hulls. It is less than half the width of their narrowest faces, which resists rolling anyway."""
LEAST_FRICTION = 0.05
"""Coefficient of friction. Bodies with a smaller one get less rolling friction."""
STIFFNESS, DAMPING = 1e9, 1e8
"""N/m and N s/m of static bodies. The spring takes back the share dt k / (dt k + d) of a contact's depth in each step,
4% at 4.4 ms. Where contacts are close together for the size of the body (the narrow face of a hull, the end of a pencil
that stands), the solver lets one of them sink by 0.1% of what gravity adds in a step. Without a spring it never rises
again, and the body tips over the edge."""
DISC = 0.004
"""m. Thickness of the discs at a cylinder's ends; Bullet rounds their edges by 1 mm."""


def may_roll(shapes: Iterable[Shape], mass: float, frame: BodyFrame) -> bool:
    """Whether a body needs this: it turns easily, and its shapes can be round."""
    return frame.turns_easily(mass) and any(shape.kind in ("cylinder", "capsule", "hull") for shape in shapes)


def ends(shapes: Iterable[Shape]) -> Iterator[Shape]:
    """A shape inside each end of cylinders and capsules. They get contacts of their own, with static bodies alone."""
    for shape in shapes:
        if shape.kind not in ("cylinder", "capsule"):
            continue
        radius, length = shape.size
        thickness = min(DISC, length / 4)
        arm = length / 2 if shape.kind == "capsule" else (length - thickness) / 2
        along = matrix_from_quaternion(np.array(shape.quaternion))[:, 2] * arm
        for sign in (1.0, -1.0):
            x, y, z = (float(v) for v in np.array(shape.position) + sign * along)
            if shape.kind == "capsule":
                yield Shape("sphere", (radius,), (x, y, z))
            else:
                yield replace(shape, size=(radius, thickness), position=(x, y, z))
