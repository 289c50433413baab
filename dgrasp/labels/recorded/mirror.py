"""Mirror images of labels: from a right hand to a left one, and back."""

from __future__ import annotations

import dataclasses

import numpy as np

from dgrasp.hand.mano.model import MIRROR, MIRROR_ANGLES
from dgrasp.types import Array, GraspLabel, StartPose

MIRRORED = "_mirrored"
"""Suffix of a mirrored hand's id, if no id is given for it."""

_WORLD = np.array([1.0, -1.0, 1.0])
"""Signs of the mirror image at the world's plane y = 0, in which the table is its own image."""
_POSE = np.tile(MIRROR_ANGLES, 15)


def mirror_label(label: GraspLabel, hand: str | None = None, object_axis: int = 0) -> GraspLabel:
    """The mirror image of a label at the world's plane y = 0, for the mirror image of its hand.

    hand: id of that hand; by default the id of the label's hand with "_mirrored" appended, or removed if it is there.
    object_axis: 0, 1 or 2, the axis x, y or z of the object's frame across which the object is its own mirror
    image. An object without such a plane becomes another object; its label then fits only a mirrored mesh.
    The hand is mirrored at x = 0 of its wrist frame, as MANO's hands are.
    """
    if hand is None:
        hand = label.hand.removesuffix(MIRRORED) if label.hand.endswith(MIRRORED) else label.hand + MIRRORED
    signs = np.where(np.arange(3) == object_axis, -1.0, 1.0)
    start = None
    if label.start is not None:
        start = StartPose(
            _mirrored(label.start.T_WH, MIRROR), _mirrored(label.start.T_WO, signs), label.start.hand_pose * _POSE
        )
    return dataclasses.replace(
        label, hand_pose=label.hand_pose * _POSE, T_WH=_mirrored(label.T_WH, MIRROR), T_WO=_mirrored(label.T_WO, signs),
        joints_W=label.joints_W * _WORLD, start=start, hand=hand,
    )  # fmt: skip


def _mirrored(T: Array, local: Array) -> Array:
    """W T L, again a proper pose, for the world's mirror W and the frame's own mirror L. local (3,): L's signs."""
    out = T.copy()
    out[:3, :3] = _WORLD[:, None] * T[:3, :3] * local
    out[:3, 3] = _WORLD * T[:3, 3]
    return out
