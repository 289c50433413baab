"""Wrist control of a learned policy that moves to a target: residual actions along and about the world's axes."""

from __future__ import annotations

import numpy as np

from dgrasp.config.sections import EnvConfig, MotionConfig
from dgrasp.control.controllers import GRASP_CONTROLLERS, HOLD_KP_POSITION
from dgrasp.control.motion import nearest_euler
from dgrasp.hand.layout import N_WRIST, HandLayout
from dgrasp.types import Array, GraspGoal, SceneState
from raisim_like.rotations import matrix_from_euler, matrix_from_rotation_vector, rotate_back


def move_wrist(target: Array, state: SceneState, actions: Array, motion: MotionConfig, rows: slice | Array) -> None:
    """Add actions (N, 6) to the wrist's part of PD targets (N, D), in some rows.

    The first three actions shift the wrist in units of `sigma_position`. The others are a rotation vector about the
    wrist in units of `sigma_rotation`. Both are along the axes of W, as psi is, not along those of H0, which differ
    from label to label.
    """
    R_H0W = np.swapaxes(state.R_WH0[rows], 1, 2)
    shift_W, turn_W = motion.sigma_position * actions[rows, :3], motion.sigma_rotation * actions[rows, 3:]
    wrist = target[rows, :N_WRIST]
    wrist[:, :3] += rotate_back(state.R_WH0[rows], shift_W)
    turn_H0 = np.matmul(R_H0W, np.matmul(matrix_from_rotation_vector(turn_W), state.R_WH0[rows]))
    wrist[:, 3:] = nearest_euler(np.matmul(turn_H0, matrix_from_euler(wrist[:, 3:])), state.gc[rows, 3:6])
    target[rows, :N_WRIST] = wrist


class WholeHand:
    """Flat-RL: the bias of grasping (`env.wrist`), with a wrist as stiff as in motion synthesis.

    sigma is that of the fingers and zero for the wrist; `move_wrist` adds the wrist's actions. There is no feed-forward
    for the object's weight: the policy must find out when the object is lifted.
    """

    kp_position = HOLD_KP_POSITION

    def __init__(self, config: EnvConfig, hand: HandLayout) -> None:
        self._grasp = GRASP_CONTROLLERS[config.wrist](config.action, hand)
        self.sigma = self._grasp.sigma.copy()
        self.sigma[:N_WRIST] = 0.0

    def bias(self, state: SceneState, goal: GraspGoal, out: Array) -> None:
        """Write q_b into out (N, D)."""
        self._grasp.bias(state, goal, out)
