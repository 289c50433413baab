"""Whether contacts can hold an object against its weight by friction; without that there is no grasp."""

from __future__ import annotations

import numpy as np

from dgrasp.types import Array

EDGES = 8
"""Edges of the pyramid inside a friction cone."""
MAX_FORCE = 20.0
"""Largest sum of the normal forces, in object weights. A grasp that needs more presses the object out of the hand."""


def holds_weight(points: Array, normals: Array, center: Array, up: Array, friction: float) -> bool:
    """Whether forces within the friction cones of contacts balance the object's weight.

    points: (C, 3) m. normals: (C, 3) outward unit normals of the object's surface there. center: (3,) m, the centre of
    mass. up: (3,). All are in the object's frame. The only other limit on the forces is that of their sum
    (`MAX_FORCE`).
    """
    from scipy.optimize import linprog

    if len(points) == 0:
        return False
    side = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(normals, side)
    angles = 2.0 * np.pi * np.arange(EDGES) / EDGES
    tangents = np.cos(angles)[:, None, None] * side + np.sin(angles)[:, None, None] * other
    forces = (friction * tangents - normals).reshape(-1, 3)
    levers = np.broadcast_to(points - center, tangents.shape).reshape(-1, 3)
    # Torques are divided by a lever of 5 cm, so that both kinds of rows are similar in size.
    wrenches = np.concatenate([forces, np.cross(levers / 0.05, forces)], axis=1).T
    # Each edge has a normal force of 1.
    balance = np.concatenate([up, np.zeros(3)])
    found = linprog(np.ones(len(forces)), A_eq=wrenches, b_eq=balance, bounds=(0.0, None), method="highs")
    return bool(found.status == 0 and found.fun <= MAX_FORCE)
