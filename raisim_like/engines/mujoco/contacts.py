"""MuJoCo's contacts: Coulomb's law for sliding ones, and their forces."""

from __future__ import annotations

import mujoco as mj
import numpy as np

from raisim_like.contact import Contact
from raisim_like.engines.mujoco.model import BuiltModel
from raisim_like.engines.protocol import Array


class SlidingContacts:
    """Keeps the sliding contacts of a compiled model closed (docs/physics.md).

    MuJoCo's convex contact law separates two bodies at friction times their sliding speed, so that a sliding block
    hops. De Saxcé's correction subtracts that speed from the contact's target normal velocity. It runs between
    `mj_step1` and `mj_step2` of every step, so it touches as few of MuJoCo's arrays as it can and keeps its own.
    """

    def __init__(self, built: BuiltModel, friction: float) -> None:
        """friction: coefficient of all pairs that the model does not name."""
        self._data = built.data
        # Arrays without dimensions, because numpy takes twice as long with plain numbers.
        self._timestep = np.array(built.model.opt.timestep)
        # Without named pairs friction is the same everywhere. MuJoCo raises smaller values to its minimum.
        self._friction = np.array(max(friction, mj.mjMINMU)) if not built.model.npair else None
        self._rolling = bool((built.model.pair_dim > 3).any())
        self._speed = np.empty(64)

    def set_timestep(self, timestep: float) -> None:
        """Length of the coming steps, s."""
        self._timestep[()] = timestep

    def keep_closed(self) -> None:
        """Correct the contacts of the coming step."""
        data = self._data
        if self._rolling:
            self._keep_closed_by_rows()
            return
        # The contacts come last, after ties and joint limits. Each has three rows: the normal and two tangents.
        first, velocity = data.ne + data.nl, data.efc_vel
        count = (len(velocity) - first) // 3
        if not count:
            return
        if count > len(self._speed):
            self._speed = np.empty(2 * count)
        speed, aim = self._speed[:count], data.efc_aref[first::3]
        np.hypot(velocity[first + 1 :: 3], velocity[first + 2 :: 3], speed)
        np.multiply(self._frictions(count) if self._friction is None else self._friction, speed, speed)
        np.divide(speed, self._timestep, speed)
        np.subtract(aim, speed, aim)

    def _keep_closed_by_rows(self) -> None:
        """The same where contacts differ in their number of rows: those with rolling friction have six."""
        data = self._data
        rows = data.contact.efc_address
        acting = rows >= 0
        rows = rows[acting]
        speed = np.hypot(data.efc_vel[rows + 1], data.efc_vel[rows + 2])
        data.efc_aref[rows] -= data.contact.friction[acting, 0] * speed / self._timestep

    def _frictions(self, count: int) -> Array:
        """(count,) friction of the contacts that have a force."""
        contact = self._data.contact
        friction = contact.friction[:, 0]
        # Points on the edge of the margin have no force.
        return friction if count == self._data.ncon else friction[contact.efc_address >= 0]


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
