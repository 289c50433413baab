"""Convert labels to goals in the object's frame, once per label (supplement, A.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgrasp.types import GraspGoal, GraspLabel
from raisim_like.rotations import euler_from_matrix


def make_goal(labels: Sequence[GraspLabel]) -> GraspGoal:
    """The goals of N labels, one row each."""
    T_WH = np.array([label.T_WH for label in labels])
    T_WO = np.array([label.T_WO for label in labels])
    joints_W = np.array([label.joints_W for label in labels])
    R_WO = T_WO[:, :3, :3]
    joints_O = np.matmul(joints_W - T_WO[:, None, :3, 3], R_WO)
    R_OH = np.matmul(np.swapaxes(R_WO, 1, 2), T_WH[:, :3, :3])
    return GraspGoal(
        joints_O=joints_O,
        R_OH=R_OH,
        hand_pose=np.array([label.hand_pose for label in labels]),
        goal_contacts=np.array([label.goal_contacts for label in labels], dtype=float),
        wrist_euler_O=euler_from_matrix(R_OH),
    )
