"""Rigid bodies of a world."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from raisim_like.contact import Contact
from raisim_like.engines.protocol import EngineWorld
from raisim_like.rotations import matrix_from_quaternion

Array = NDArray[Any]


class Owner(Protocol):
    """What an object needs from its world."""

    engine_world: EngineWorld

    @property
    def gravity(self) -> Array:
        """(3,) m/s^2, world."""


def vector3(value: Any, what: str) -> Array:
    """`value` as a finite (3,) vector. Raises `ValueError` for anything else."""
    vector = np.asarray(value, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{what}: expected 3 finite numbers, got {value}")
    return vector


class RigidBody:
    """A rigid body: box, cylinder, sphere, capsule, mesh, hull or a compound of them."""

    def __init__(self, world: Owner, body: int, mass: float, com: Array, inertia: Array) -> None:
        self._world, self.id, self.mass = world, body, mass
        self._com, self._inertia = com, inertia
        self._state = np.zeros(13)
        self.name = ""

    @property
    def state(self) -> Array:
        """(13,): position, quaternion (w, x, y, z), linear and angular velocity of the body's frame, world."""
        self._world.engine_world.get_body_state(self.id, self._state)
        return self._state.copy()

    @property
    def position(self) -> Array:
        """(3,) m, world."""
        return self.state[:3]

    @property
    def rotation(self) -> Array:
        """(3, 3) R_WB."""
        return matrix_from_quaternion(self.state[3:7])

    @property
    def linear_velocity(self) -> Array:
        """(3,) m/s of the body frame's origin, world."""
        return self.state[7:10]

    @property
    def angular_velocity(self) -> Array:
        """(3,) rad/s, world."""
        return self.state[10:13]

    def set_state(
        self, position: Any, quaternion: Any = (1, 0, 0, 0), linear: Any = (0, 0, 0), angular: Any = (0, 0, 0)
    ) -> None:
        """Place the body: position m, quaternion w x y z, velocities m/s and rad/s, all world."""
        state = np.concatenate([np.asarray(part, dtype=float) for part in (position, quaternion, linear, angular)])
        if state.shape != (13,) or not np.isfinite(state).all():
            raise ValueError(f"expected position 3, quaternion 4, velocities 3 and 3, all finite; got {state}")
        self._world.engine_world.set_body_state(self.id, state)

    def set_external_force(self, force: Any, position: Any | None = None) -> None:
        """Apply a force (3,) N, world, in the next substep only; it adds to the other forces.

        position: (3,) m in the body's frame, the point where the force acts; by default the centre of mass.
        """
        force = vector3(force, "force")
        arm = np.zeros(3) if position is None else self.rotation @ (vector3(position, "position") - self._com)
        self._world.engine_world.apply_wrench(self.id, force, np.cross(arm, force))

    def set_external_torque(self, torque: Any) -> None:
        """Apply a torque (3,) N m, world, in the next substep only; it adds to the other torques."""
        self._world.engine_world.apply_wrench(self.id, np.zeros(3), vector3(torque, "torque"))

    @property
    def center_of_mass(self) -> Array:
        """(3,) m, world."""
        return self.position + self.rotation @ self._com

    @property
    def linear_momentum(self) -> Array:
        """(3,) kg m/s, world."""
        state = self.state
        arm = matrix_from_quaternion(state[3:7]) @ self._com
        return self.mass * (state[7:10] + np.cross(state[10:13], arm))

    def angular_momentum(self, about: Any = (0, 0, 0)) -> Array:
        """(3,) kg m^2/s, world, about a point (3,) m of the world."""
        spin = self._inertia_W @ self.angular_velocity if self.mass > 0 else np.zeros(3)
        return spin + np.cross(self.center_of_mass - np.asarray(about, dtype=float), self.linear_momentum)

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy of translation and rotation, J."""
        if self.mass == 0:
            return 0.0
        momentum, omega = self.linear_momentum, self.angular_velocity
        return float(momentum @ momentum / self.mass + omega @ self._inertia_W @ omega) / 2

    @property
    def potential_energy(self) -> float:
        """Potential energy in the world's gravity, J; zero at the world's origin."""
        return -self.mass * float(self._world.gravity @ self.center_of_mass)

    @property
    def _inertia_W(self) -> Array:
        R = self.rotation
        return R @ self._inertia @ R.T

    def contacts(self) -> list[Contact]:
        """Contact points of the last step."""
        return self._world.engine_world.contacts(self.id)
