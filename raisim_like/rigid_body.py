"""Rigid bodies of a world."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raisim_like.contact import Contact
from raisim_like.rotations import matrix_from_quaternion

if TYPE_CHECKING:
    from raisim_like.world import World

Array = NDArray[Any]


class RigidBody:
    """A rigid body: box, cylinder, sphere, capsule, mesh, hull or a compound of them."""

    def __init__(self, world: World, body: int, mass: float) -> None:
        self._world, self.id, self.mass = world, body, mass
        self._state = np.zeros(13)

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

    def contacts(self) -> list[Contact]:
        """Contact points of the last step."""
        return self._world.engine_world.contacts(self.id)
