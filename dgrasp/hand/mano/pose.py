"""Convert finger poses between MANO and the project: PCA, rotation vectors, Euler angles, order of fingers.

MANO lists rotation vectors of 15 joints, fingers in the order index, middle, little, ring, thumb; the project lists
intrinsic XYZ Euler angles, index, middle, ring, little, thumb.
"""

from __future__ import annotations

import numpy as np

from dgrasp.errors import DataError
from dgrasp.hand.mano.model import PART_TO_MANO, ManoModel
from dgrasp.types import Array
from raisim_like.rotations import euler_from_matrix, matrix_from_euler

_JOINTS = np.array(PART_TO_MANO[1:]) - 1
_BACK = np.argsort(_JOINTS)


def project_pose(rotation_vectors: Array) -> Array:
    """The project's (N, 45) Euler angles, rad, of MANO's (N, 45) rotation vectors."""
    from scipy.spatial.transform import Rotation

    vectors = _rows(rotation_vectors)[:, _JOINTS]
    R = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
    return euler_from_matrix(R).reshape(len(vectors), 45)


def mano_pose(hand_pose: Array) -> Array:
    """MANO's (N, 45) rotation vectors, with angles up to pi, of the project's (N, 45) Euler angles."""
    from scipy.spatial.transform import Rotation

    angles = _rows(hand_pose)[:, _BACK]
    R = matrix_from_euler(angles.reshape(-1, 3))
    return Rotation.from_matrix(R).as_rotvec().reshape(len(angles), 45)


def from_pca(model: ManoModel, coefficients: Array, flat_hand_mean: bool) -> Array:
    """MANO's (N, 45) rotation vectors of PCA coefficients (N, K <= 45).

    flat_hand_mean: whether the coefficients count from the flat hand, as in some data sets, instead of from MANO's mean
    pose (DexYCB: False).
    """
    rows = np.asarray(coefficients, dtype=float)
    if rows.ndim != 2 or not 1 <= rows.shape[1] <= 45:
        raise DataError(f"PCA coefficients of shape {rows.shape}; expected (poses, 1 to 45)")
    mean = np.zeros(45) if flat_hand_mean else model.hands_mean
    return mean + rows @ model.hands_components[: rows.shape[1]]


def to_pca(model: ManoModel, rotation_vectors: Array, flat_hand_mean: bool) -> Array:
    """All 45 PCA coefficients (N, 45) of MANO's (N, 45) rotation vectors: the inverse of `from_pca`."""
    mean = np.zeros(45) if flat_hand_mean else model.hands_mean
    rows = _rows(rotation_vectors).reshape(-1, 45)
    return np.linalg.solve(model.hands_components.T, (rows - mean).T).T


def _rows(pose: Array) -> Array:
    rows = np.asarray(pose, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != 45:
        raise DataError(f"a hand pose of shape {rows.shape}; expected (poses, 45)")
    return rows.reshape(len(rows), 15, 3)
