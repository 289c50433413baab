"""The start of an episode, also for labels without an approach, and the labels that take part in an epoch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgrasp.config.sections import NoiseConfig
from dgrasp.hand.model import HandModel
from dgrasp.types import Array, GraspLabel, StartPose
from raisim_like.rotations import matrix_from_euler

APPROACH_DISTANCE = 0.10
"""Distance (m) of the wrist's start from its goal, away from the object (supplement B.5: "a predefined distance")."""
GOLDEN = 0.6180339887498949
"""The golden ratio minus 1: steps of this fraction of a circle cover it evenly."""


def start_pose(label: GraspLabel, hand: HandModel) -> StartPose:
    """The label's own start, or a hand at rest with its wrist `APPROACH_DISTANCE` back from the goal."""
    if label.start is not None:
        return label.start
    away = label.T_WH[:3, 3] - label.T_WO[:3, 3]
    distance = float(np.linalg.norm(away))
    direction = away / distance if distance > 1e-6 else np.array([0.0, 0.0, 1.0])
    T_WH = label.T_WH.copy()
    T_WH[:3, 3] += APPROACH_DISTANCE * direction
    return StartPose(T_WH, label.T_WO, hand.rest)


def with_noise(start: StartPose, noise: NoiseConfig, rng: np.random.Generator) -> StartPose:
    """The start with uniform noise on the wrist's pose and the finger angles; the object does not move."""
    T = start.T_WH.copy()
    half = np.array([noise.wrist_xy, noise.wrist_xy, noise.wrist_z])
    T[:3, 3] += rng.uniform(-half, half)
    T[:3, :3] = T[:3, :3] @ matrix_from_euler(rng.uniform(-noise.wrist_angle, noise.wrist_angle, 3))
    pose = start.hand_pose + rng.uniform(-noise.finger_angle, noise.finger_angle, len(start.hand_pose))
    return StartPose(T, start.T_WO, pose)


def taking_part(seed: int, epoch: int, count: int, indices: Sequence[int], total: int) -> Array:
    """(N,) bool: which of the labels at `indices` of a set of `total` take part in an epoch of `count` labels.

    Takes labels at equal spacing from a start that moves through the whole set from epoch to epoch, the same in every
    process. Labels of one object are adjacent in the set, so every epoch contains each object in proportion. All labels
    take part equally often.
    """
    if count >= total:
        return np.ones(len(indices), bool)
    # The spawn key separates this stream from those of the environments.
    first = np.random.default_rng(np.random.SeedSequence([seed], spawn_key=(3,))).random()
    start = (first + epoch * GOLDEN) % 1.0
    return np.isin(indices, ((np.arange(count) + start) * (total / count)).astype(int))
