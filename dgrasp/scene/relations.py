"""Quantities that follow from a state and a goal, for features, rewards and controllers (supplement, A.1 and A.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.config.sections import WristError
from dgrasp.hand.layout import N_WRIST
from dgrasp.types import Array, GraspGoal, SceneState
from raisim_like.rotations import euler_from_matrix, matrix_from_euler, rotate, rotation_vector


@dataclass
class Relations:
    """Quantities of N states that features and rewards share, computed once per control step.

    joint_position_error_H: (N, K, 3) m, goal minus current key points, in the wrist frame (g_x).
    pose_error: (N, 3 + J) rad, the wrist's rotation error in the object frame, then finger angles; goal minus current
        (g_q).
    """

    joint_position_error_H: Array
    pose_error: Array


def relations(state: SceneState, goal: GraspGoal, wrist_error: WristError = "euler") -> Relations:
    """g_x and g_q (supplement, A.1).

    wrist_error: how g_q measures the wrist. "euler" is the difference of intrinsic XYZ Euler angles, as in the paper;
    it jumps by up to 2 pi where an angle passes pi. "rotation_vector" is the rotation from the current to the goal
    orientation, axis times angle in the object frame; its length is the angle between them, at most pi.
    """
    n = len(state.gc)
    target_W = state.object_pos_W[:, None] + np.matmul(goal.joints_O, np.swapaxes(state.R_WO, 1, 2))
    error_H = np.matmul(target_W - state.joints_W, state.R_WH)
    pose = np.empty((n, 3 + goal.hand_pose.shape[1]))
    R_OH = np.matmul(np.swapaxes(state.R_WO, 1, 2), state.R_WH)
    if wrist_error == "euler":
        pose[:, :3] = goal.wrist_euler_O - euler_from_matrix(R_OH)
    else:
        pose[:, :3] = rotation_vector(np.matmul(goal.R_OH, np.swapaxes(R_OH, 1, 2)))
    pose[:, 3:] = goal.hand_pose - state.gc[:, N_WRIST:]
    return Relations(error_H, pose)


def target_turn_W(state: SceneState) -> Array:
    """(N, 3) rad: the rotation vector from the target's orientation to the object's (g_o,q)."""
    return rotation_vector(np.matmul(state.R_WO, np.swapaxes(state.R_WG, 1, 2)))


def wrist_angvel_W(state: SceneState) -> Array:
    """(N, 3) rad/s: the wrist's angular velocity, from the rates of its intrinsic XYZ Euler angles."""
    angles, rates = state.gc[:, 3:6], state.gv[:, 3:6]
    zero = np.zeros(len(angles))
    R_X = matrix_from_euler(np.stack([angles[:, 0], zero, zero], axis=1))
    R_XY = matrix_from_euler(np.stack([angles[:, 0], angles[:, 1], zero], axis=1))
    # Each joint turns about its own axis, which the joints before it have turned.
    omega_H0 = R_X[:, :, 1] * rates[:, 1:2] + R_XY[:, :, 2] * rates[:, 2:3]
    omega_H0[:, 0] += rates[:, 0]
    return rotate(state.R_WH0, omega_H0)


def goal_wrist_position_W(state: SceneState, goal: GraspGoal) -> Array:
    """(N, 3) m: the position of the label's wrist relative to the object, at the object's current pose."""
    return state.object_pos_W + rotate(state.R_WO, goal.joints_O[:, 0])
