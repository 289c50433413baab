"""The contacts of a compiled MuJoCo model, and their forces."""

from __future__ import annotations

import mujoco as mj
import numpy as np

from raisim_like.contact import Contact
from raisim_like.engines.mujoco.built import BuiltModel
from raisim_like.engines.protocol import Array

PAIR = np.array([1, 1 << 20])
"""Weights that make one number of the two bodies of a contact."""


def pair_forces(built: BuiltModel, body: int, other: int) -> tuple[Array, Array]:
    """Link indices of `body` and normal forces (N) at its contacts with `other` in the last substep."""
    contact = built.data.contact
    rows, geoms = contact.efc_address, contact.geom
    pairs = built.owner[geoms] @ PAIR
    first = pairs == body + PAIR[1] * other
    found = ((first | (pairs == other + PAIR[1] * body)) & (rows >= 0)).nonzero()[0]
    mine = geoms[found, (~first[found]).astype(int)]
    return built.link[mine], built.data.efc_force[rows[found]]


def contacts_of(built: BuiltModel, body: int, timestep: float) -> list[Contact]:
    """The contact points of a body in the last substep."""
    found, force = [], np.zeros(6)
    for i, c in enumerate(built.data.contact):
        owner, link = built.owner[c.geom], built.link[c.geom]
        if c.efc_address < 0 or body not in owner:
            continue
        # The frame's first row is the normal from the first geom to the second; the position is halfway.
        a, sign = (0, -1.0) if owner[0] == body else (1, 1.0)
        frame = sign * c.frame.reshape(3, 3)
        mj.mj_contactForce(built.model, built.data, i, force)
        found.append(
            Contact(
                int(owner[a]), int(owner[1 - a]), int(link[a]), int(link[1 - a]), c.pos - frame[0] * c.dist / 2,
                frame[0], -float(c.dist), float(force[0]) * timestep,
                (force[1] * frame[1] + force[2] * frame[2]) * timestep,
            )
        )  # fmt: skip
    return found
