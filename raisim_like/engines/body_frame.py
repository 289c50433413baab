"""A rigid body's own frame and the frame that engines simulate: at the centre of mass, along the principal axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from raisim_like.engines.protocol import Array
from raisim_like.rotations import matrix_from_quaternion, quaternion_from_matrix
from raisim_like.shapes import Shape

GYRATION = 0.3
"""m. A body with a smaller least radius of gyration turns as easily as things on a table do. The authors' objects have
larger ones, because their moments are 1 kg m^2."""


class BodyFrame:
    """Converts states between a body's frame B and its inertial frame I.

    com: (3,) origin of I in B. axes: (3, 3) R_BI. moments: (3,) principal moments of inertia, kg m^2. States (..., 13)
    have the layout of `EngineWorld.set_body_state`.
    """

    def __init__(self, com: Array, inertia: Array) -> None:
        self.com = np.asarray(com, dtype=float)
        inertia = np.asarray(inertia, dtype=float)
        if np.array_equal(inertia, np.diag(np.diag(inertia))):
            self.moments, self.axes = np.diag(inertia).copy(), np.eye(3)
        else:
            self.moments, self.axes = np.linalg.eigh(inertia)
            if np.linalg.det(self.axes) < 0:
                self.axes[:, 0] *= -1
        self.plain = bool(np.all(self.com == 0) and np.array_equal(self.axes, np.eye(3)))

    def turns_easily(self, mass: float) -> bool:
        """Whether a body of `mass` kg can be set rolling by small errors of its contacts (docs/physics.md, "Rest")."""
        return 0.0 < self.moments.min() < mass * GYRATION**2

    def shape_in_inertial(self, shape: Shape) -> Shape:
        """A shape of the body, expressed in I."""
        if self.plain:
            return shape
        R = self.axes.T @ matrix_from_quaternion(np.array(shape.quaternion))
        x, y, z = (float(v) for v in self.axes.T @ (np.array(shape.position) - self.com))
        w, i, j, k = (float(v) for v in quaternion_from_matrix(R))
        return replace(shape, position=(x, y, z), quaternion=(w, i, j, k))

    def to_inertial(self, state: Array) -> Array:
        """The states (..., 13) of I that correspond to states (..., 13) of B."""
        if self.plain:
            return state
        out = state.copy()
        R = matrix_from_quaternion(state[..., 3:7])
        offset = R @ self.com
        out[..., :3] += offset
        out[..., 3:7] = quaternion_from_matrix(R @ self.axes)
        out[..., 7:10] += np.cross(state[..., 10:13], offset)
        return out

    def from_inertial(self, state: Array) -> None:
        """Convert states (..., 13) of I to the states of B, in place."""
        if self.plain:
            return
        R = matrix_from_quaternion(state[..., 3:7]) @ self.axes.T
        offset = R @ self.com
        state[..., :3] -= offset
        state[..., 3:7] = quaternion_from_matrix(R)
        state[..., 7:10] -= np.cross(state[..., 10:13], offset)
