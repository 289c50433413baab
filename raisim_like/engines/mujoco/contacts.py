"""MuJoCo's contacts: Coulomb's law where they slide, and their forces."""

from __future__ import annotations

import mujoco as mj
import numpy as np

from raisim_like.contact import Contact
from raisim_like.engines.mujoco.model import BuiltModel
from raisim_like.engines.protocol import Array


def keep_sliding_contacts_closed(data: mj.MjData, timestep: float) -> None:
    """Between `mj_step1` and `mj_step2`: lets sliding contacts stay closed (docs/physics.md).

    MuJoCo's convex contact law parts two bodies at friction times their sliding speed, so that a sliding block
    hops. De Saxcé's correction takes that speed off the normal velocity that the contact aims at.
    """
    # The constraints end with the contacts, three rows each: the normal and two tangents.
    first = data.ne + data.nf + data.nl
    count = (data.nefc - first) // 3
    if not count:
        return
    contact = data.contact
    friction = contact.friction[:, 0]
    if count < data.ncon:
        # Points on the edge of the margin have no force.
        friction = friction[contact.efc_address >= 0]
    velocity = data.efc_vel[first:].reshape(-1, 3)
    data.efc_aref[first::3] -= friction * np.hypot(velocity[:, 1], velocity[:, 2]) / timestep


def pair_forces(built: BuiltModel, body: int, other: int) -> tuple[Array, Array]:
    """Link indices of `body` and normal forces (N) at its contacts with `other` in the last substep."""
    contact = built.data.contact
    rows, geoms = contact.efc_address, contact.geom
    first, second = built.owner[geoms].T
    between = (first == body) & (second == other) | (first == other) & (second == body)
    found = np.flatnonzero(between & (rows >= 0))
    mine = geoms[found, (first[found] != body).astype(int)]
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
