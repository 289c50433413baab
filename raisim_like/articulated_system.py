"""Articulated systems of a world, with RaiSim's vocabulary."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raisim_like.contact import Contact
from raisim_like.kinematics import jacobian, link_velocities
from raisim_like.rigid_body import Owner, vector3
from raisim_like.urdf import UrdfModel

Array = NDArray[Any]


class ArticulatedSystem:
    """A fixed-base articulated system under PD control with feed-forward force.

    Generalised coordinates (dof,): rad or m, in the depth-first joint order of the URDF. A joint that follows another
    one (`model.ties`) has a coordinate too. It has no motor: its gains and its target have no effect, and its
    coordinate and velocity are set to those that it must have.
    """

    def __init__(self, world: Owner, body: int, model: UrdfModel) -> None:
        self._world, self.id, self.model = world, body, model
        self._gc, self._gv = np.zeros(model.dof), np.zeros(model.dof)
        self.name = model.name

    @property
    def dof(self) -> int:
        """Number of coordinates."""
        return self.model.dof

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the moving links, one per coordinate."""
        return tuple(link.name for link in self.model.links)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, one per coordinate."""
        return self.model.joint_names

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all links in the file, fixed ones included. The methods below take them as frames."""
        return tuple(self.model.frames)

    @property
    def joint_limits(self) -> Array:
        """(dof, 2) lower and upper limits."""
        return self.model.joint_limits

    def set_base_pose(self, position: Any, quaternion: Any = (1, 0, 0, 0)) -> None:
        """Set the pose of the fixed base in the world: position (3,) m, quaternion w, x, y, z."""
        self._world.engine_world.set_base_pose(self.id, np.asarray(position), np.asarray(quaternion))

    def set_state(self, gc: Any, gv: Any | None = None) -> None:
        """Set coordinates and velocities (by default 0), (dof,) each, and reset the controller's memory."""
        ties = self.model.ties
        q = ties.coordinates(self._vector(gc, "gc"))
        v = ties.velocities(self._vector(np.zeros(self.dof) if gv is None else gv, "gv"))
        self._world.engine_world.set_joint_state(self.id, q, v)

    @property
    def generalized_coordinate(self) -> Array:
        """Generalised coordinates (dof,)."""
        self._world.engine_world.get_joint_state(self.id, self._gc, self._gv)
        return self._gc.copy()

    @property
    def generalized_velocity(self) -> Array:
        """Generalised velocities (dof,)."""
        self._world.engine_world.get_joint_state(self.id, self._gc, self._gv)
        return self._gv.copy()

    @property
    def state(self) -> tuple[Array, Array]:
        """Generalised coordinates and velocities, (dof,) each."""
        return self.generalized_coordinate, self.generalized_velocity

    def set_pd_gains(self, kp: Any, kd: Any) -> None:
        """Set the PD gains, (dof,) or scalars: N m/rad and N m s/rad (N/m and N s/m for prismatic joints)."""
        gains = np.array([self._vector(kp, "kp"), self._vector(kd, "kd")])
        gains[:, self.model.ties.followers] = 0.0
        self._world.engine_world.set_pd_gains(self.id, *gains)

    def set_pd_target(self, target: Any) -> None:
        """Set the PD position target (dof,); the target velocity is zero."""
        self._world.engine_world.set_pd_target(self.id, self._vector(target, "target"))

    def set_generalized_force(self, force: Any) -> None:
        """Set the feed-forward force (dof,), which is added to the PD law."""
        self._world.engine_world.set_feed_forward(self.id, self._vector(force, "force"))

    def mass_matrix(self) -> Array:
        """Mass matrix (dof, dof) as the engine simulates it, as if no joint followed another."""
        return self._world.engine_world.mass_matrix(self.id)

    def frame_pose(self, frame: str) -> tuple[Array, Array]:
        """World rotation (3, 3) and origin (3,) of a link frame of the URDF, fixed ones included."""
        index, T = self._frame(frame)
        R, t = self._link_poses()
        return R[index] @ T[:3, :3], R[index] @ T[:3, 3] + t[index]

    def frame_velocity(self, frame: str) -> tuple[Array, Array]:
        """Velocity (3,) m/s of a link frame's origin and its angular velocity (3,) rad/s, world."""
        linear, angular = self.frame_jacobian(frame)
        velocity = self.generalized_velocity
        return linear @ velocity, angular @ velocity

    def frame_jacobian(self, frame: str) -> tuple[Array, Array]:
        """Jacobians (3, dof) of a link frame's origin velocity and of its angular velocity, world."""
        index, T = self._frame(frame)
        R, t = self._link_poses()
        return jacobian(self.model, R, t, index, R[index] @ T[:3, 3] + t[index])

    def set_external_force(self, frame: str, force: Any, position: Any | None = None) -> None:
        """Apply a force (3,) N, world, to a link in the next substep only; it adds to the other forces.

        frame: name of the link. position: (3,) m in that frame, the point where the force acts; by default the link's
        centre of mass (for a fixed link, that of the moving link it belongs to).
        """
        index, T = self._frame(frame)
        R, t = self._link_poses()
        at = self.model.links[index].com if position is None else T[:3, :3] @ vector3(position, "position") + T[:3, 3]
        linear, _ = jacobian(self.model, R, t, index, R[index] @ at + t[index])
        self._world.engine_world.apply_generalized_force(self.id, linear.T @ vector3(force, "force"))

    def set_external_torque(self, frame: str, torque: Any) -> None:
        """Apply a torque (3,) N m, world, to a link in the next substep only; it adds to the other torques."""
        _, angular = self.frame_jacobian(frame)
        self._world.engine_world.apply_generalized_force(self.id, angular.T @ vector3(torque, "torque"))

    # Mechanics of the links as the URDF gives them. Inertia that the controller or the engine adds is not included.

    @property
    def mass(self) -> float:
        """Mass of the moving links, kg."""
        return self.model.mass

    @property
    def center_of_mass(self) -> Array:
        """(3,) m, world."""
        return self._masses @ self._centers(*self._link_poses()) / self.mass

    @property
    def linear_momentum(self) -> Array:
        """(3,) kg m/s, world."""
        _, velocities, _, _ = self._motion()
        return self._masses @ velocities

    def angular_momentum(self, about: Any = (0, 0, 0)) -> Array:
        """(3,) kg m^2/s, world, about a point (3,) m of the world."""
        centers, velocities, omega, inertias = self._motion()
        arms = centers - np.asarray(about, dtype=float)
        spins = np.matmul(inertias, omega[:, :, None])[..., 0]
        return (self._masses[:, None] * np.cross(arms, velocities) + spins).sum(axis=0)

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy, J."""
        _, velocities, omega, inertias = self._motion()
        turning = np.einsum("ni,nij,nj->", omega, inertias, omega)
        return float(self._masses @ (velocities**2).sum(axis=1) + turning) / 2

    @property
    def potential_energy(self) -> float:
        """Potential energy in the world's gravity, J; zero at the world's origin."""
        return -float(self._world.gravity @ (self._masses @ self._centers(*self._link_poses())))

    def contacts(self) -> list[Contact]:
        """Contact points of the last step."""
        return self._world.engine_world.contacts(self.id)

    def _frame(self, frame: str) -> tuple[int, Array]:
        """Index of the moving link that a frame belongs to, and the frame's pose (4, 4) in that link."""
        if frame not in self.model.frames:
            raise ValueError(f"{self.model.path} has no link {frame!r}; it has {sorted(self.model.frames)}")
        index, T = self.model.frames[frame]
        if index < 0:
            raise ValueError(f"link {frame!r} is part of the fixed base")
        return index, T

    def _link_poses(self) -> tuple[Array, Array]:
        return self._world.engine_world.link_poses(self.id)

    @property
    def _masses(self) -> Array:
        return np.array([link.mass for link in self.model.links])

    def _centers(self, R: Array, t: Array) -> Array:
        coms = np.array([link.com for link in self.model.links])
        return t + np.matmul(R, coms[:, :, None])[..., 0]

    def _motion(self) -> tuple[Array, Array, Array, Array]:
        """Centres of mass, their velocities, angular velocities (dof, 3) and inertias (dof, 3, 3), world."""
        R, t = self._link_poses()
        centers = self._centers(R, t)
        linear, omega = link_velocities(self.model, R, t, self.generalized_velocity)
        inertias = np.array([link.inertia for link in self.model.links])
        return centers, linear + np.cross(omega, centers - t), omega, R @ inertias @ np.swapaxes(R, -1, -2)

    def _vector(self, value: Any, what: str) -> Array:
        vector = np.broadcast_to(np.asarray(value, dtype=float), (self.dof,)) if np.ndim(value) == 0 else np.asarray(
            value, dtype=float
        )
        if vector.shape != (self.dof,):
            raise ValueError(f"{what}: expected shape ({self.dof},), got {vector.shape}")
        if not np.isfinite(vector).all():
            raise ValueError(f"{what}: not finite")
        return vector
