"""Joint limits of a hand in MANO's wrist frame: from an anatomical table, or from a set of labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgrasp.errors import DataError
from dgrasp.hand.free.anatomy import anatomical_limits
from dgrasp.hand.mano.model import MIRROR_ANGLES
from dgrasp.hand.mano.skeleton import FINGERS, N_FINGER_DOF
from dgrasp.types import Array, GraspLabel

LABEL_SLACK = 0.1
"""rad, added to both ends of the range that labels span."""


def table_limits(joints: Array, tips: Array) -> Array:
    """(45, 2) rad of a right hand: the norms of joint motion, with their slack, of `dgrasp.hand.free.anatomy`.

    The norms are turned to the hand's own bones: joints (16, 3), order of `skeleton.PARTS`, and fingertips (5, 3) at
    the zero pose in one frame parallel to the wrist's.
    """
    limits = []
    for index, finger in enumerate(FINGERS):
        chain = np.vstack([joints[1 + 3 * index : 4 + 3 * index], tips[index]])
        bones = np.diff(chain, axis=0)
        lengths = np.linalg.norm(bones, axis=1, keepdims=True)
        if lengths.min() < 1e-3:
            raise DataError(f"a bone of the {finger} finger is shorter than 1 mm; expected the joints of a hand")
        for segment, bone in enumerate(bones / lengths):
            limits.append(anatomical_limits(finger, segment, bone))
    return np.concatenate(limits)


def label_limits(labels: Sequence[GraspLabel]) -> Array:
    """(45, 2) rad: the range of all grasps and starts of the labels, widened by `LABEL_SLACK` on both sides."""
    poses = [label.hand_pose for label in labels]
    poses += [label.start.hand_pose for label in labels if label.start is not None]
    if not poses:
        raise DataError("no labels to take joint limits from; expected at least one")
    rows = np.stack(poses)
    return np.stack([rows.min(axis=0) - LABEL_SLACK, rows.max(axis=0) + LABEL_SLACK], axis=1)


def mirror_limits(limits: Array) -> Array:
    """(45, 2) rad: the limits of the mirrored hand."""
    signs = np.tile(MIRROR_ANGLES, N_FINGER_DOF // 3)[:, None]
    return np.sort(limits * signs, axis=1)
