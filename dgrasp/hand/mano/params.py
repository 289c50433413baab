"""Convert MANO's parameters of hands to the project's coordinates, and back.

MANO turns a hand about the wrist joint J0 of its shape and then shifts it: the wrist is at J0 + translation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.errors import DataError
from dgrasp.hand.mano.model import ManoModel
from dgrasp.hand.mano.pose import mano_pose, project_pose
from dgrasp.hand.mano.skinning import numpy_skin
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_euler, transform


@dataclass(frozen=True, eq=False)
class ManoParams:
    """N hands in frame A as MANO describes them.

    orient (N, 3): rotation vectors of R_AH, rad. pose (N, 45): rotation vectors of the finger joints from the flat
    hand, MANO's order of fingers (index, middle, little, ring, thumb), rad. transl (N, 3): MANO's translation, m.
    betas (N, S): shape.
    """

    orient: Array
    pose: Array
    transl: Array
    betas: Array

    def coordinates(self, model: ManoModel) -> tuple[Array, Array]:
        """Wrists T_AH (N, 4, 4) and the project's finger angles hand_pose (N, 45)."""
        from scipy.spatial.transform import Rotation

        R = Rotation.from_rotvec(self.orient).as_matrix()
        return transform(R, wrist_joints(model, self.betas) + self.transl), project_pose(self.pose)

    @classmethod
    def of(cls, model: ManoModel, betas: Array, T_AH: Array, hand_pose: Array) -> ManoParams:
        """The parameters of hands with wrists T_AH (N, 4, 4), finger angles (N, 45) and shapes betas (N, S).

        The inverse of `coordinates` for rotation vectors of at most pi.
        """
        from scipy.spatial.transform import Rotation

        orient = Rotation.from_matrix(T_AH[:, :3, :3]).as_rotvec()
        return cls(orient, mano_pose(hand_pose), T_AH[:, :3, 3] - wrist_joints(model, betas), betas)


def wrist_joints(model: ManoModel, betas: Array) -> Array:
    """(N, 3) m: J0, the wrist joint of shapes betas (N, S) at the zero pose, MANO's frame."""
    rows = model.own_betas(betas)
    if not (np.abs(rows) <= 20.0).all():
        raise DataError("betas beyond 20; expected finite numbers of a few units (mean 0, deviation 1)")
    # J0 needs one row of the regressor, for all shapes at once.
    rest: Array = model.J_regressor[0] @ model.template
    basis = np.einsum("v,vcs->sc", model.J_regressor[0], model.shape_basis[..., : rows.shape[1]])
    return rest + rows @ basis


def hand_vertices(model: ManoModel, betas: Array, T_AH: Array, hand_pose: Array) -> tuple[Array, Array]:
    """Vertices (N, V, 3) and key points (N, 21, 3) in frame A of hands with shapes betas (N, S), (1, S) for all."""
    n = len(T_AH)
    rotations = np.empty((n, 16, 3, 3))
    rotations[:, 0] = T_AH[:, :3, :3]
    rotations[:, 1:] = matrix_from_euler(hand_pose.reshape(n, 15, 3))
    vertices, keypoints = numpy_skin(model).forward(rotations, T_AH[:, :3, 3], betas)
    return np.asarray(vertices), np.asarray(keypoints)
