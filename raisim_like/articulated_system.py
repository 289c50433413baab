"""Articulated systems of a world, with RaiSim's vocabulary."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raisim_like.contact import Contact
from raisim_like.urdf import UrdfModel

if TYPE_CHECKING:
    from raisim_like.world import World

Array = NDArray[Any]


class ArticulatedSystem:
    """A fixed-base articulated system under PD control with feed-forward force.

    Generalised coordinates (dof,): rad or m, in the depth-first joint order of the URDF.
    """

    def __init__(self, world: World, body: int, model: UrdfModel) -> None:
        self._world, self.id, self.model = world, body, model
        self._gc, self._gv = np.zeros(model.dof), np.zeros(model.dof)

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return self.model.dof

    @property
    def joint_limits(self) -> Array:
        """(dof, 2) lower and upper limits."""
        return self.model.joint_limits

    def set_base_pose(self, position: Any, quaternion: Any = (1, 0, 0, 0)) -> None:
        """Pose of the fixed base in the world, quaternion w x y z."""
        self._world.engine_world.set_base_pose(self.id, np.asarray(position), np.asarray(quaternion))

    def set_state(self, gc: Any, gv: Any | None = None) -> None:
        """Generalised coordinates and velocities (dof,); the controller forgets its past."""
        velocity = np.zeros(self.dof) if gv is None else gv
        self._world.engine_world.set_joint_state(self.id, self._vector(gc, "gc"), self._vector(velocity, "gv"))

    @property
    def generalized_coordinate(self) -> Array:
        """(dof,)"""
        self._world.engine_world.get_joint_state(self.id, self._gc, self._gv)
        return self._gc.copy()

    @property
    def generalized_velocity(self) -> Array:
        """(dof,)"""
        self._world.engine_world.get_joint_state(self.id, self._gc, self._gv)
        return self._gv.copy()

    def set_pd_gains(self, kp: Any, kd: Any) -> None:
        """PD gains (dof,) or scalars, N m/rad and N m s/rad (N/m and N s/m for prismatic joints)."""
        self._world.engine_world.set_pd_gains(self.id, self._vector(kp, "kp"), self._vector(kd, "kd"))

    def set_pd_target(self, target: Any) -> None:
        """PD position target (dof,); the target velocity is zero."""
        self._world.engine_world.set_pd_target(self.id, self._vector(target, "target"))

    def set_generalized_force(self, force: Any) -> None:
        """Feed-forward force (dof,), added to the PD law."""
        self._world.engine_world.set_feed_forward(self.id, self._vector(force, "force"))

    def mass_matrix(self) -> Array:
        """(dof, dof) as simulated."""
        return self._world.engine_world.mass_matrix(self.id)

    def frame_pose(self, frame: str) -> tuple[Array, Array]:
        """World rotation (3, 3) and origin (3,) of a link frame of the URDF, fixed ones included."""
        if frame not in self.model.frames:
            raise ValueError(f"{self.model.path} has no link {frame!r}; it has {sorted(self.model.frames)}")
        index, T = self.model.frames[frame]
        if index < 0:
            raise ValueError(f"link {frame!r} is part of the fixed base")
        R, t = self._world.engine_world.link_poses(self.id)
        return R[index] @ T[:3, :3], R[index] @ T[:3, 3] + t[index]

    def contacts(self) -> list[Contact]:
        """Contact points of the last step."""
        return self._world.engine_world.contacts(self.id)

    def _vector(self, value: Any, what: str) -> Array:
        vector = np.broadcast_to(np.asarray(value, dtype=float), (self.dof,)) if np.ndim(value) == 0 else np.asarray(
            value, dtype=float
        )
        if vector.shape != (self.dof,):
            raise ValueError(f"{what}: expected shape ({self.dof},), got {vector.shape}")
        if not np.isfinite(vector).all():
            raise ValueError(f"{what}: not finite")
        return vector
