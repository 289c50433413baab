"""Contact points of a PyBullet client, read after its last step.

`impulse_per_force` (s) turns the forces that Bullet reports into the impulses of the last substep.
"""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from raisim_like.contact import Contact
from raisim_like.engines.bullet.quiet_pybullet import pybullet as p
from raisim_like.engines.protocol import Array


def link_impulses(client: int, body: int, other: int, impulse_per_force: float, out: Array) -> None:
    """Write the summed normal impulse (N s) of each link of `body` against `other` into out (dof,)."""
    out[:] = 0.0
    for point in p.getContactPoints(body, other, physicsClientId=client):
        # Bullet keeps several points per pair, some of them almost without force; only their sum is meaningful.
        if point[3] >= 0:
            out[point[3]] += point[9] * impulse_per_force


def touching(client: int, body: int, other: int) -> bool:
    """Whether two bodies press on each other."""
    return any(point[9] > 0.0 for point in p.getContactPoints(body, other, physicsClientId=client))


def contacts_of(client: int, body: int, impulse_per_force: float, rigid: Container[int]) -> list[Contact]:
    """All contact points of a body. rigid: bodies whose links are parts of one and the same."""
    found = []
    # When asked for one body, Bullet swaps the bodies of a pair but not its friction directions, so ask for all.
    for c in p.getContactPoints(physicsClientId=client):
        if body not in (c[1], c[2]):
            continue
        a, b, on_b, sign = (0, 1, c[6], 1.0) if c[1] == body else (1, 0, c[5], -1.0)
        link_a, link_b = (-1 if c[1 + k] in rigid else c[3 + k] for k in (a, b))
        tangential = np.array(c[11]) * c[10] + np.array(c[13]) * c[12]
        found.append(
            Contact(
                c[1 + a], c[1 + b], link_a, link_b, np.array(on_b), sign * np.array(c[7]), -c[8],
                c[9] * impulse_per_force, sign * tangential * impulse_per_force,
            )
        )  # fmt: skip
    return found
