"""How a hand's joints move in life: 21 anatomical motions, their angles, and a Gaussian prior of grasping hands.

There are no recorded hands in it, only anatomy: each motion turns about an axis of `free_anatomy.anatomical_axes`,
the outer joint of a finger follows the middle one by two thirds, and neighbouring fingers bend alike. A motion's angle
times its axis is taken for Euler angles, as the joint limits do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.hand.free.anatomy import anatomical_axes
from dgrasp.hand.mano.model import MIRROR, MIRROR_ANGLES, Side
from dgrasp.hand.mano.skeleton import FINGERS, N_FINGER_DOF, PART_PARENT
from dgrasp.hand.model import HandModel
from dgrasp.types import Array

_FINGER_MOTIONS = (("spread", 0, 1), ("proximal", 0, 2), ("middle", 1, 2), ("distal", 2, 2))
_THUMB_MOTIONS = (("twist", 0, 0), ("lift", 0, 1), ("proximal", 0, 2), ("middle", 1, 2), ("distal", 2, 2))
"""Name, joint, and axis: twist, to the side (for the thumb: out of the palm's plane), flexion."""

MOTIONS = (
    *(f"{finger}_{name}" for finger in FINGERS[:4] for name, _, _ in _FINGER_MOTIONS),
    *(f"thumb_{name}" for name, _, _ in _THUMB_MOTIONS),
)
"""The 21 motions, in the order of all arrays here."""

_MEAN_DEG = {"spread": 0.0, "proximal": 32.0, "middle": 38.0, "distal": 22.0}
_THUMB_MEAN_DEG = (0.0, 28.0, 2.0, 12.0, 18.0)
_SPREAD_DEG, _PROXIMAL_DEG, _MIDDLE_DEG, _DISTAL_DEG = 6.0, 18.0, 20.0, 6.0
_THUMB_DEG = (6.0, 14.0, 12.0, 12.0, 14.0)
_FOLLOWS = 2.0 / 3.0
"""How far the distal joint follows the middle one."""
_ALIKE = 0.75
"""Correlation of the same flexion in neighbouring fingers; its powers for those farther apart."""


@dataclass(frozen=True, eq=False)
class HandMotions:
    """to_pose (21, 45): the joint angles that a motion of 1 rad makes. palmar (16, 3): where each part's pad faces, in
    its frame. mean (21,), factor (21, 21): of the prior; mean + factor @ z with standard normal z is drawn from it."""

    to_pose: Array
    palmar: Array
    mean: Array
    factor: Array

    @property
    def whiten(self) -> Array:
        """(21, 21): its product with (motions - mean) is standard normal under the prior."""
        return np.asarray(np.linalg.inv(self.factor))


def hand_motions(hand: HandModel, side: Side = "right") -> HandMotions:
    """The motions of a hand in MANO's wrist frame, the axes turned to its own bones."""
    mirror, turns = (np.ones(3), np.ones(3)) if side == "right" else (MIRROR, MIRROR_ANGLES)
    to_pose = np.zeros((len(MOTIONS), N_FINGER_DOF))
    palmar = np.zeros((len(PART_PARENT), 3))
    palmar[0] = 0.0, -1.0, 0.0
    row = 0
    for f, finger in enumerate(FINGERS):
        chain = [*hand.offsets[2 + 3 * f : 4 + 3 * f], hand.tips[f]]
        axes = []
        for segment, bone in enumerate(chain):
            unit = mirror * bone / np.linalg.norm(bone)
            axes.append(anatomical_axes(finger, segment, unit))
            palmar[1 + 3 * f + segment] = mirror * np.cross(axes[-1][2], unit)
        for _, segment, axis in _THUMB_MOTIONS if finger == "thumb" else _FINGER_MOTIONS:
            start = 9 * f + 3 * segment
            to_pose[row, start : start + 3] = turns * axes[segment][axis]
            row += 1
    mean = np.radians([*(list(_MEAN_DEG.values()) * 4), *_THUMB_MEAN_DEG])
    return HandMotions(to_pose, palmar, mean, np.linalg.cholesky(_covariance()))


def _covariance() -> Array:
    """(21, 21) rad^2."""
    own = np.diag(np.square([_SPREAD_DEG, _PROXIMAL_DEG, _MIDDLE_DEG, 0.0]))
    alike = np.array([[_ALIKE ** abs(i - j) for j in range(4)] for i in range(4)])
    fingers = np.kron(alike, own)
    # The fingers' spread is their own.
    for i in range(4):
        for j in range(4):
            fingers[4 * i, 4 * j] = _SPREAD_DEG**2 if i == j else 0.0
    follow = np.kron(np.eye(4), np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, _FOLLOWS, 1]], dtype=float))
    fingers = follow @ fingers @ follow.T + np.kron(np.eye(4), np.diag([0.0, 0.0, 0.0, _DISTAL_DEG**2]))
    whole = np.zeros((len(MOTIONS), len(MOTIONS)))
    whole[:16, :16] = fingers
    whole[16:, 16:] = np.diag(np.square(_THUMB_DEG))
    return np.asarray(whole * np.radians(1.0) ** 2)
