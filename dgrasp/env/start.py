"""Where an episode begins, also for labels that are one static grasp without an approach; and whether it does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgrasp.config.sections import NoiseConfig
from dgrasp.hand.model import HandModel
from dgrasp.types import Array, GraspLabel, StartPose
from raisim_like.rotations import matrix_from_euler

APPROACH_DISTANCE = 0.10
"""m that the wrist is drawn back from its goal, away from the object (supplement B.5: "a predefined distance")."""
GOLDEN = 0.6180339887498949
"""Steps of this share of a circle visit all of it evenly."""


def start_pose(label: GraspLabel, hand: HandModel) -> StartPose:
    """The label's own start, or the wrist drawn back from the object with a hand at rest."""
    if label.start is not None:
        return label.start
    away = label.T_WH[:3, 3] - label.T_WO[:3, 3]
    distance = float(np.linalg.norm(away))
    direction = away / distance if distance > 1e-6 else np.array([0.0, 0.0, 1.0])
    T_WH = label.T_WH.copy()
    T_WH[:3, 3] += APPROACH_DISTANCE * direction
    return StartPose(T_WH, label.T_WO, hand.rest)


def with_noise(start: StartPose, noise: NoiseConfig, rng: np.random.Generator) -> StartPose:
    """The start with the hand somewhat elsewhere, its angles somewhat others; the object stays."""
    T = start.T_WH.copy()
    half = np.array([noise.wrist_xy, noise.wrist_xy, noise.wrist_z])
    T[:3, 3] += rng.uniform(-half, half)
    T[:3, :3] = T[:3, :3] @ matrix_from_euler(rng.uniform(-noise.wrist_angle, noise.wrist_angle, 3))
    pose = start.hand_pose + rng.uniform(-noise.finger_angle, noise.finger_angle, len(start.hand_pose))
    return StartPose(T, start.T_WO, pose)


def taking_part(seed: int, epoch: int, count: int, indices: Sequence[int], total: int) -> Array:
    """(N,) bool: which of the labels at `indices` of a set of `total` take part in an epoch of `count`.

    Every k-th label of the whole set from a start that walks through all, the same draw in every process: labels of an
    object stand side by side, so that each epoch has its share of every object, and all labels take part equally often.
    """
    if count >= total:
        return np.ones(len(indices), bool)
    # The spawn key keeps it apart from the environments' own streams.
    first = np.random.default_rng(np.random.SeedSequence([seed], spawn_key=(3,))).random()
    start = (first + epoch * GOLDEN) % 1.0
    return np.isin(indices, ((np.arange(count) + start) * (total / count)).astype(int))
