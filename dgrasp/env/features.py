"""Feature layers: the policy's view of a state and a goal (paper, section 3.2.1; supplement, A.1 and A.2).

Every layer is a tuple of `Feature`s. Sizes, slices and the tables in docs/features.md are derived from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dgrasp.config.sections import EnvConfig
from dgrasp.config.tasks import TASKS
from dgrasp.hand.layout import N_WRIST, HandLayout
from dgrasp.scene.relations import Relations, target_turn_W, wrist_angvel_W
from dgrasp.types import Array, GraspGoal, SceneState
from raisim_like.rotations import euler_from_matrix, rotate, rotate_back

Term = Callable[[SceneState, GraspGoal, Relations], Array]
Size = Callable[[HandLayout], int]


@dataclass(frozen=True)
class Feature:
    """One block of the observation: its size, frame and unit, and the function that computes it, (N, size).

    size: a number, or a function of the hand. is_goal: left out with `env.goal_space=false`. scale: factor that brings
    the values to order 1 (`env.scaled_features`): one number, or one for the first three entries (the wrist's
    translation) and one for the rest.
    """

    name: str
    size: int | Size
    frame: str
    unit: str
    value: Term
    is_goal: bool = False
    scale: float | tuple[float, float] = 1.0

    def size_for(self, hand: HandLayout) -> int:
        """The size of the block for a hand."""
        return self.size if isinstance(self.size, int) else self.size(hand)

    def scale_for(self, hand: HandLayout) -> Array:
        """(size,) the scale of each entry for a hand."""
        size = self.size_for(hand)
        if isinstance(self.scale, float):
            return np.full(size, self.scale)
        translation, rest = self.scale
        return np.r_[np.full(3, translation), np.full(size - 3, rest)]


def _dofs(hand: HandLayout) -> int:
    return hand.n_dof


def _fingers(hand: HandLayout) -> int:
    return hand.n_joints


def _rotations(hand: HandLayout) -> int:
    return 3 + hand.n_joints


def _points(hand: HandLayout) -> int:
    return 3 * hand.n_keypoints


def _parts(hand: HandLayout) -> int:
    return hand.n_parts


def _flat(values: Array) -> Array:
    return values.reshape(len(values), -1)


def _table_height_H(s: SceneState, g: GraspGoal, r: Relations) -> Array:
    up = np.zeros((len(s.gc), 3))
    up[:, 2] = s.joints_W[:, 0, 2] - s.table_height_W
    return rotate_back(s.R_WH, up)


PHI: tuple[Feature, ...] = (
    Feature("joint_positions", _dofs, "H0", "m, rad", lambda s, g, r: s.gc, scale=(5.0, 1.0)),
    Feature("wrist_linvel", 3, "H0", "m/s", lambda s, g, r: s.gv[:, 0:3], scale=0.2),
    Feature("wrist_angvel", 3, "H0 (Euler rates)", "rad/s", lambda s, g, r: s.gv[:, 3:6], scale=0.2),
    Feature("finger_velocities", _fingers, "joint", "rad/s", lambda s, g, r: s.gv[:, N_WRIST:], scale=0.2),
    Feature(
        "joint_position_error_H", _points, "H", "m", lambda s, g, r: _flat(r.joint_position_error_H), True, scale=10.0,
    ),
    Feature("pose_error", _rotations, "O (wrist), joint", "rad", lambda s, g, r: r.pose_error, True, scale=2.0),
    Feature(
        "wrist_from_object_H", 3, "H", "m", lambda s, g, r: rotate_back(s.R_WH, s.joints_W[:, 0] - s.object_pos_W),
        scale=8.0,
    ),
    Feature("object_linvel_H", 3, "H", "m/s", lambda s, g, r: rotate_back(s.R_WH, s.object_linvel_W), scale=2.0),
    Feature("object_angvel_H", 3, "H", "rad/s", lambda s, g, r: rotate_back(s.R_WH, s.object_angvel_W), scale=0.2),
    Feature("goal_contacts", _parts, "-", "0/1", lambda s, g, r: g.goal_contacts, True),
    Feature("contact_impulse", _parts, "-", "N s", lambda s, g, r: s.contact_impulse, scale=20.0),
    Feature("achieved_contacts", _parts, "-", "0/1", lambda s, g, r: g.goal_contacts * s.contacts, True),
    Feature(
        "object_displacement_H", 3, "H", "m", lambda s, g, r: rotate_back(s.R_WH, s.object_start_W - s.object_pos_W),
        scale=10.0,
    ),
    Feature("table_height_H", 3, "H", "m", _table_height_H, scale=5.0),
    Feature(
        "object_euler_H", 3, "H", "rad",
        lambda s, g, r: euler_from_matrix(np.matmul(np.swapaxes(s.R_WH, 1, 2), s.R_WO)), scale=0.5,
    ),
)  # fmt: skip
"""phi, in the published order (paper, equation 3)."""

FULL_STATE: tuple[Feature, ...] = (
    Feature("joint_positions", _dofs, "H0", "m, rad", lambda s, g, r: s.gc, scale=(5.0, 1.0)),
    Feature("joint_velocities", _dofs, "H0, joint", "m/s, rad/s", lambda s, g, r: s.gv, scale=0.2),
    Feature("wrist_position_W", 3, "W", "m", lambda s, g, r: s.joints_W[:, 0], scale=5.0),
    Feature("wrist_euler_W", 3, "W", "rad", lambda s, g, r: euler_from_matrix(s.R_WH), scale=0.5),
    Feature("object_position_W", 3, "W", "m", lambda s, g, r: s.object_pos_W, scale=5.0),
    Feature("object_euler_W", 3, "W", "rad", lambda s, g, r: euler_from_matrix(s.R_WO), scale=0.5),
    Feature("object_linvel_W", 3, "W", "m/s", lambda s, g, r: s.object_linvel_W, scale=2.0),
    Feature("object_angvel_W", 3, "W", "rad/s", lambda s, g, r: s.object_angvel_W, scale=0.2),
    Feature("contact_impulse", _parts, "-", "N s", lambda s, g, r: s.contact_impulse, scale=20.0),
    Feature("label_joints_O", _points, "O", "m", lambda s, g, r: _flat(g.joints_O), True, scale=8.0),
    Feature("label_wrist_euler_O", 3, "O", "rad", lambda s, g, r: g.wrist_euler_O, True, scale=0.5),
    Feature("label_hand_pose", _fingers, "joint", "rad", lambda s, g, r: g.hand_pose, True),
    Feature("goal_contacts", _parts, "-", "0/1", lambda s, g, r: g.goal_contacts, True),
)
"""The state and the label without the feature layer (the paper's ablation "w/o FeatLayer")."""

PSI: tuple[Feature, ...] = (
    Feature("wrist_position_W", 3, "W", "m", lambda s, g, r: s.joints_W[:, 0], scale=5.0),
    Feature("wrist_euler_W", 3, "W", "rad", lambda s, g, r: euler_from_matrix(s.R_WH), scale=0.5),
    Feature("wrist_linvel_W", 3, "W", "m/s", lambda s, g, r: rotate(s.R_WH0, s.gv[:, :3]), scale=2.0),
    Feature("wrist_angvel_W", 3, "W", "rad/s", lambda s, g, r: wrist_angvel_W(s), scale=0.2),
    Feature("object_position_W", 3, "W", "m", lambda s, g, r: s.object_pos_W, scale=5.0),
    Feature("object_euler_W", 3, "W", "rad", lambda s, g, r: euler_from_matrix(s.R_WO), scale=0.5),
    Feature("object_linvel_W", 3, "W", "m/s", lambda s, g, r: s.object_linvel_W, scale=2.0),
    Feature("object_angvel_W", 3, "W", "rad/s", lambda s, g, r: s.object_angvel_W, scale=0.2),
    Feature("target_offset_W", 3, "W", "m", lambda s, g, r: s.object_pos_W - s.target_pos_W, scale=5.0),
    Feature("target_turn_W", 3, "W", "rad (rotation vector)", lambda s, g, r: target_turn_W(s), scale=2.0),
)
"""psi, the input of a policy that moves the object: T_h, its rates, T_o, its rates, g_o,x, g_o,q (supplement, A.2)."""

FEATURE_LAYERS = {"phi": PHI, "full_state": FULL_STATE}
"""The layers that `env.features` names."""
LAYERS = FEATURE_LAYERS | {"psi": PSI}
"""All layers that a task can have (`dgrasp.config.tasks`)."""

CRITIC: tuple[Feature, ...] = (
    Feature("table_gone", 1, "-", "0/1", lambda s, g, r: s.table_gone[:, None]),
    Feature("episode_time", 1, "-", "share", lambda s, g, r: s.episode_time[:, None]),
)
"""Features that only the critic may see (`env.critic_features`); they tell how much reward an episode has left."""

SCALED_RANGE = 5.0
"""Scaled features are clamped to +- this value."""


def _of_task(config: EnvConfig) -> tuple[Feature, ...]:
    """The features that the actor sees: those of the task's layers. Of two with one name, the first is taken."""
    found: dict[str, Feature] = {}
    for name in TASKS[config.task].features:
        for feature in LAYERS[config.features if name == "env.features" else name]:
            if config.goal_space or not feature.is_goal:
                found.setdefault(feature.name, feature)
    return tuple(found.values())


class FeatureLayer:
    """Writes the features of a task as one observation (N, size) float32. The actor sees the first `actor_size`."""

    def __init__(self, config: EnvConfig, hand: HandLayout) -> None:
        chosen = _of_task(config)
        self.features = chosen + (CRITIC if config.critic_features else ())
        self.slices: dict[str, slice] = {}
        start = 0
        for feature in self.features:
            self.slices[feature.name] = slice(start, start + feature.size_for(hand))
            start += feature.size_for(hand)
        self.size = start
        self.actor_size = sum(feature.size_for(hand) for feature in chosen)
        scales = [feature.scale_for(hand) for feature in self.features]
        self._scale = np.concatenate(scales).astype(np.float32) if config.scaled_features else None

    def __call__(self, state: SceneState, goal: GraspGoal, r: Relations, out: Array) -> None:
        """Write the observation into `out` (N, size)."""
        for feature, part in zip(self.features, self.slices.values(), strict=True):
            out[:, part] = feature.value(state, goal, r)
        if self._scale is not None:
            out *= self._scale
            np.clip(out, -SCALED_RANGE, SCALED_RANGE, out=out)


def features_page() -> str:
    """The text of docs/features.md: the meaning of each number of the observations, for a hand with MANO's joints."""
    from dgrasp.hand.store import open_hand

    hand = open_hand("free").model.layout
    lines = [
        "# Observations",
        "",
        "Generated by `python -m dgrasp.env.features > docs/features.md`; a test checks that this page is up to date.",
        "Frames: W world, O object, H wrist, H0 wrist at the start of the episode. Blocks marked *goal* are left",
        "out with `env.goal_space=false`. Vectors and Euler angles (intrinsic XYZ) are in the frame named.",
        "The wrist's part of *pose_error* is a difference of Euler angles, or with",
        "`env.wrist_error=rotation_vector` a rotation vector in the same frame.",
        "With `env.scaled_features=true` each block is multiplied by its scale (of two, the first is for the wrist's",
        f"translation) and clamped to +-{SCALED_RANGE:g}. With `env.critic_features=true` the critic sees in addition",
        f"{', '.join(f'*{feature.name}*' for feature in CRITIC)} at the end of its observation.",
        "With `env.task=flat` the numbers of `env.features` are followed by those of `env.task=motion`.",
    ]
    choices = [("features", name) for name in FEATURE_LAYERS] + [("task", "motion")]
    for key, name in choices:
        layer = FeatureLayer(EnvConfig.model_validate({key: name}), hand)
        lines += ["", f"## `env.{key}={name}`: {layer.size} numbers", ""]
        lines += ["| numbers | name | frame | unit | scale | |", "|---|---|---|---|---|---|"]
        for feature in layer.features:
            part = layer.slices[feature.name]
            goal = "goal" if feature.is_goal else ""
            scale = " ".join(f"{value:g}" for value in dict.fromkeys(np.ravel(feature.scale).tolist()))
            lines.append(
                f"| {part.start}:{part.stop} | {feature.name} | {feature.frame} | {feature.unit} | {scale} | {goal} |"
            )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(features_page(), end="")
