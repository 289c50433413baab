"""Controllers, whose bias the residual action is added to; one per phase and ablation (paper, equations 1 and 2).

A controller gives the bias q_b (N, D) of the PD target and the scale sigma (D,) of the action;
the target is q_b + sigma * a, clipped to the joint limits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from dgrasp.config.sections import ActionConfig
from dgrasp.hand.layout import N_WRIST, HandLayout
from dgrasp.scene.relations import goal_wrist_position_W
from dgrasp.types import Array, GraspGoal, SceneState
from raisim_like.rotations import rotate_back

HOLD_KP_POSITION = 500.0
"""N/m of the wrist's translation while it holds or carries the object (docs/deviations.md)."""


class Controller(Protocol):
    """Bias and action scale of one phase; `kp_position` (N/m) is the stiffness of the wrist's position."""

    sigma: Array
    kp_position: float

    def bias(self, state: SceneState, goal: GraspGoal, out: Array) -> None:
        """Write q_b into out (N, D)."""


def _sigma(config: ActionConfig, hand: HandLayout, wrist_position: float) -> Array:
    sigma = np.full(hand.n_dof, config.sigma_fingers)
    sigma[:3] = wrist_position
    sigma[3:N_WRIST] = config.sigma_wrist_rotation
    return sigma


class WristGuidance:
    """Bias the wrist's position to the label's, relative to the object's current pose; all else keeps its place.

    Paper, section 3.2.3.
    """

    def __init__(self, config: ActionConfig, hand: HandLayout) -> None:
        self.sigma = _sigma(config, hand, config.sigma_wrist_position)
        self.kp_position = config.kp_position

    def bias(self, state: SceneState, goal: GraspGoal, out: Array) -> None:
        out[:] = state.gc
        out[:, :3] = rotate_back(state.R_WH0, goal_wrist_position_W(state, goal) - state.wrist_start_W)


class Residual:
    """Bias all joints to where they are (the ablation "w/o WristGuidance"); sigma is 10 times as large for the wrist's
    position."""

    def __init__(self, config: ActionConfig, hand: HandLayout) -> None:
        self.sigma = _sigma(config, hand, 10.0 * config.sigma_wrist_position)
        self.kp_position = config.kp_position

    def bias(self, state: SceneState, goal: GraspGoal, out: Array) -> None:
        out[:] = state.gc


class WristHold:
    """Hold the wrist at the pose that it had when this controller began; the policy controls the fingers."""

    kp_position = HOLD_KP_POSITION

    def __init__(self, config: ActionConfig, hand: HandLayout, state: SceneState) -> None:
        self.sigma = _sigma(config, hand, 0.0)
        self.sigma[:N_WRIST] = 0.0
        self._wrist = state.gc[:, :N_WRIST].copy()

    def catch(self, state: SceneState, rows: Array) -> None:
        """Hold the wrists of some environments, given by their rows (n,), where they are now."""
        self._wrist[rows] = state.gc[rows, :N_WRIST]

    def bias(self, state: SceneState, goal: GraspGoal, out: Array) -> None:
        out[:] = state.gc
        out[:, :N_WRIST] = self._wrist


class LabelPose:
    """Hold wrist and fingers at the label's pose (the baseline *+PD, supplement B.4); actions have no effect."""

    kp_position = HOLD_KP_POSITION

    def __init__(self, config: ActionConfig, hand: HandLayout) -> None:
        self.sigma: Array = np.zeros(hand.n_dof)

    def bias(self, state: SceneState, goal: GraspGoal, out: Array) -> None:
        out[:, :N_WRIST] = 0.0
        out[:, N_WRIST:] = goal.hand_pose


GRASP_CONTROLLERS: dict[str, Callable[[ActionConfig, HandLayout], Controller]] = {
    "guidance": WristGuidance,
    "residual": Residual,
}
"""The controllers of grasping by the names that `env.wrist` takes."""
