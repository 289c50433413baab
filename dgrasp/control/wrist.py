"""A learned policy's wrist on the way to a target: residual actions along and about the world's axes."""

from __future__ import annotations

import numpy as np

from dgrasp.config.sections import EnvConfig, MotionConfig
from dgrasp.control.controllers import GRASP_CONTROLLERS, HOLD_KP_POSITION
from dgrasp.control.motion import nearest_euler
from dgrasp.hand.layout import N_WRIST, HandLayout
from dgrasp.types import Array, GraspGoal, SceneState
from raisim_like.rotations import matrix_from_euler, matrix_from_rotation_vector, rotate_back


def move_wrist(target: Array, state: SceneState, actions: Array, motion: MotionConfig, rows: slice | Array) -> None:
    """Adds actions (N, 6) to the wrist's part of PD targets (N, D), in some rows.

    The first three shift it by `sigma_position` each, the others are a rotation vector about the wrist in units of
    `sigma_rotation`. Both are along the axes of W, in which psi is written, not those of H0, which each label has its
    own of.
    """
    R_H0W = np.swapaxes(state.R_WH0[rows], 1, 2)
    shift_W, turn_W = motion.sigma_position * actions[rows, :3], motion.sigma_rotation * actions[rows, 3:]
    wrist = target[rows, :N_WRIST]
    wrist[:, :3] += rotate_back(state.R_WH0[rows], shift_W)
    turn_H0 = np.matmul(R_H0W, np.matmul(matrix_from_rotation_vector(turn_W), state.R_WH0[rows]))
    wrist[:, 3:] = nearest_euler(np.matmul(turn_H0, matrix_from_euler(wrist[:, 3:])), state.gc[rows, 3:6])
    target[rows, :N_WRIST] = wrist


class WholeHand:
    """Flat-RL: bias as in grasping (`env.wrist`), and a wrist as stiff as motion synthesis has it.

    sigma is that of the fingers; `move_wrist` adds the wrist's actions. Nothing counts for the object's weight: when it
    is lifted is for the policy to find out.
    """

    kp_position = HOLD_KP_POSITION

    def __init__(self, config: EnvConfig, hand: HandLayout) -> None:
        self._grasp = GRASP_CONTROLLERS[config.wrist](config.action, hand)
        self.sigma = self._grasp.sigma.copy()
        self.sigma[:N_WRIST] = 0.0

    def bias(self, state: SceneState, goal: GraspGoal, out: Array) -> None:
        """Writes q_b into out (N, D)."""
        self._grasp.bias(state, goal, out)
