"""The reward as a sum of named terms, for grasping (paper, section 3.2.2) and for motion to a target (supplement, A.2).

docs/deviations.md lists the differences from the paper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dgrasp.config.sections import RewardConfig
from dgrasp.config.tasks import TASKS
from dgrasp.hand.layout import HandLayout
from dgrasp.scene.relations import Relations, target_turn_W
from dgrasp.types import Array, GraspGoal, SceneState


@dataclass(frozen=True, eq=False)
class Parameters:
    """Parameters of the terms: their settings, and the weights w_x,j of the key points, (K,)."""

    config: RewardConfig
    keypoint_weights: Array


Term = Callable[[SceneState, GraspGoal, Relations, Parameters], Array]


def keypoint_weights(config: RewardConfig, hand: HandLayout) -> Array:
    """(K,) w_x,j: fingertips have `tip_weight` times the weight of other key points; the mean is 1."""
    weights = np.ones(hand.n_keypoints)
    weights[list(hand.tips)] = config.tip_weight
    return weights / weights.mean()


def position_reward(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """r_x = -sum_j |w_j x_j|^2, m^2, at least `position_floor` (equation 5).

    The paper writes w_j |x_j|^2, which `squared_weights=false` gives.
    """
    w, c = p.keypoint_weights, p.config
    squares = np.sum(r.joint_position_error_H**2, axis=2)
    return np.maximum(-np.sum((w**2 if c.squared_weights else w) * squares, axis=1), c.position_floor)


def pose_reward(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """r_q = -|g_q|, rad, at least `position_floor` (equation 6)."""
    return np.maximum(-np.sqrt(np.sum(r.pose_error**2, axis=1)), p.config.position_floor)


def contact_reward(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """Fraction of goal contacts achieved (equation 7, first part)."""
    wanted = np.maximum(np.sum(g.goal_contacts, axis=1), 1.0)
    return np.sum(g.goal_contacts * s.contacts, axis=1) / wanted


def impulse_reward(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """Impulse on goal parts, N s per substep, capped at lambda m_o (equation 7, second part)."""
    impulse = np.sum(g.goal_contacts * s.contact_impulse, axis=1)
    return np.minimum(impulse, p.config.impulse_per_mass * s.object_mass)


def object_velocity_penalty(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """Squared linear velocity of the object (equation 8), m^2/s^2."""
    return np.sum(s.object_linvel_W**2, axis=1)


def object_angular_velocity_penalty(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """Squared angular velocity of the object (equation 8), rad^2/s^2."""
    return np.sum(s.object_angvel_W**2, axis=1)


def wrist_linvel_penalty(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """Squared rates of the wrist's translation (equation 8), m^2/s^2."""
    return np.sum(s.gv[:, 0:3] ** 2, axis=1)


def wrist_angvel_penalty(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """Squared rates of the wrist's Euler angles (equation 8), rad^2/s^2."""
    return np.sum(s.gv[:, 3:6] ** 2, axis=1)


def hold_reward(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """1 for every step in which the hand holds the object without a table (`env.hold`; not in the paper)."""
    return s.holding


def target_position_error(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """r_m,x: distance from the object to its target (supplement, A.2), m."""
    return np.sqrt(np.sum((s.object_pos_W - s.target_pos_W) ** 2, axis=1))


def target_rotation_error(s: SceneState, g: GraspGoal, r: Relations, p: Parameters) -> Array:
    """r_m,q: geodesic distance from the object's orientation to its target's (supplement, A.2), rad."""
    return np.sqrt(np.sum(target_turn_W(s) ** 2, axis=1))


GRASP_TERMS: dict[str, Term] = {
    "position": position_reward,
    "pose": pose_reward,
    "contact": contact_reward,
    "impulse": impulse_reward,
    "object_velocity": object_velocity_penalty,
    "object_angular_velocity": object_angular_velocity_penalty,
    "wrist_linear_velocity": wrist_linvel_penalty,
    "wrist_angular_velocity": wrist_angvel_penalty,
    "hold": hold_reward,
}
"""The terms of grasping, by the name of their weight in `RewardConfig`."""
TARGET_TERMS: dict[str, Term] = {
    "target_position": target_position_error,
    "target_rotation": target_rotation_error,
}
"""r_m, the terms of moving the object to a target."""
GROUPS = {"grasp": GRASP_TERMS, "target": TARGET_TERMS}
"""The groups of terms that a task can have (`dgrasp.config.tasks`)."""
TERMS = GRASP_TERMS | TARGET_TERMS
"""All terms."""


class Reward:
    """Weights, sums and reports the terms of a task (`env.task`) whose weight is not zero."""

    def __init__(self, config: RewardConfig, hand: HandLayout, task: str = "grasp") -> None:
        self.config = config
        self._parameters = Parameters(config, keypoint_weights(config, hand))
        of_task = [name for group in TASKS[task].rewards for name in GROUPS[group]]
        self.names = tuple(name for name in of_task if getattr(config, name) != 0.0)
        self._weights = np.array([getattr(config, name) for name in self.names])

    def __call__(self, state: SceneState, goal: GraspGoal, r: Relations, terms: Array, total: Array) -> None:
        """Write the weighted terms (N, len(names)) and their sum (N,), which is at least `clip` if that is set."""
        for i, name in enumerate(self.names):
            terms[:, i] = self._weights[i] * TERMS[name](state, goal, r, self._parameters)
        summed = terms.sum(axis=1, dtype=np.float64)
        total[:] = summed if self.config.clip is None else np.maximum(summed, self.config.clip)
