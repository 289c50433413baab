"""Natural motions of a hand's joints, and a Gaussian prior over their angles in grasping hands.

For hands with MANO's joints the motions are anatomical: each turns about an axis of `free.anatomy.anatomical_axes`. In
the prior, the outer joint of a finger follows the middle one by two thirds, and neighbouring fingers bend alike. A
motion's angle times its axis is used as Euler angles, as in the joint limits. The prior uses no recorded hands. For
other hands, each joint is a motion, and the prior follows from the joint limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dgrasp.hand.free.anatomy import anatomical_axes
from dgrasp.hand.layout import N_WRIST
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.hand.mano.model import MIRROR, MIRROR_ANGLES
from dgrasp.hand.mano.skeleton import FINGERS, N_FINGER_DOF, PART_PARENT
from dgrasp.hand.model import HandModel
from dgrasp.types import Array

_FINGER_MOTIONS = (("spread", 0, 1), ("proximal", 0, 2), ("middle", 1, 2), ("distal", 2, 2))
_THUMB_MOTIONS = (("twist", 0, 0), ("lift", 0, 1), ("proximal", 0, 2), ("middle", 1, 2), ("distal", 2, 2))
"""Name, joint, and axis of each motion. The axes are twist, to the side (for the thumb: out of the palm's plane), and
flexion."""

MANO_MOTIONS = (
    *(f"{finger}_{name}" for finger in FINGERS[:4] for name, _, _ in _FINGER_MOTIONS),
    *(f"thumb_{name}" for name, _, _ in _THUMB_MOTIONS),
)
"""The anatomical motions, in the order of all arrays about them."""

_MEAN_DEG = {"spread": 0.0, "proximal": 32.0, "middle": 38.0, "distal": 22.0}
_THUMB_MEAN_DEG = (0.0, 28.0, 2.0, 12.0, 18.0)
_SPREAD_DEG, _PROXIMAL_DEG, _MIDDLE_DEG, _DISTAL_DEG = 6.0, 18.0, 20.0, 6.0
_THUMB_DEG = (6.0, 14.0, 12.0, 12.0, 14.0)
_FOLLOWS = 2.0 / 3.0
"""Share by which the distal joint follows the middle one."""
_ALIKE = 0.75
"""Correlation of the same flexion in neighbouring fingers; fingers n apart have the n-th power of it."""

_CLOSED, _SPAN = 0.4, 0.2
"""Other hands: mean of a flexion as a share of its farther limit, and deviation of a joint as a share of its range."""
_FLEXION = 1.5
"""A joint is a flexion if its farther limit is more than this many times as far from zero as the nearer one."""


@dataclass(frozen=True, eq=False)
class HandMotions:
    """M motions of a hand with J finger joints and P parts.

    to_pose (M, J): the joint angles of a motion of 1 rad. palmar (P, 3): the direction that each part's pad faces, in
    the part's frame. mean (M,), factor (M, M): the prior; mean + factor @ z with standard normal z is a draw from it.
    flexions (M,) bool: the motions that close the hand. thumb: index of the finger that opposes the others. thumb_side:
    1 if the wrist's z axis points to the thumb's side, -1 if away from it, 0 if the hand has no such anatomy. With 0,
    the wrist may be turned in any way.
    """

    to_pose: Array
    palmar: Array
    mean: Array
    factor: Array
    flexions: Array
    thumb: int
    thumb_side: float

    @cached_property
    def whiten(self) -> Array:
        """(M, M): its product with (motions - mean) is standard normal under the prior."""
        return np.asarray(np.linalg.inv(self.factor))


def hand_motions(hand: HandModel) -> HandMotions:
    """The anatomical motions of a hand with MANO's joints, turned to its own bones; for other hands, one per joint."""
    return _anatomical(hand) if hand.layout.names == MANO_NAMES else _of_ranges(hand)


def _anatomical(hand: HandModel) -> HandMotions:
    """The anatomical motions, from axes in MANO's wrist frame."""
    mirror, turns = (MIRROR, MIRROR_ANGLES) if hand.layout.side == "left" else (np.ones(3), np.ones(3))
    to_pose = np.zeros((len(MANO_MOTIONS), N_FINGER_DOF))
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
    flexions = np.array([not name.endswith(("spread", "twist", "lift")) for name in MANO_MOTIONS])
    thumb = FINGERS.index("thumb")
    side = float(np.sign(hand.offsets[hand.layout.fingers[thumb].parts[0], 2]))
    return HandMotions(to_pose, palmar, mean, np.linalg.cholesky(_covariance()), flexions, thumb, side)


def _covariance() -> Array:
    """(M, M) rad^2: the covariance of the anatomical motions."""
    own = np.diag(np.square([_SPREAD_DEG, _PROXIMAL_DEG, _MIDDLE_DEG, 0.0]))
    alike = np.array([[_ALIKE ** abs(i - j) for j in range(4)] for i in range(4)])
    fingers = np.kron(alike, own)
    # Each finger spreads independently of the others.
    for i in range(4):
        for j in range(4):
            fingers[4 * i, 4 * j] = _SPREAD_DEG**2 if i == j else 0.0
    follow = np.kron(np.eye(4), np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, _FOLLOWS, 1]], dtype=float))
    fingers = follow @ fingers @ follow.T + np.kron(np.eye(4), np.diag([0.0, 0.0, 0.0, _DISTAL_DEG**2]))
    n, whole = len(fingers), np.zeros((len(MANO_MOTIONS), len(MANO_MOTIONS)))
    whole[:n, :n] = fingers
    whole[n:, n:] = np.diag(np.square(_THUMB_DEG))
    return np.asarray(whole * np.radians(1.0) ** 2)


def _of_ranges(hand: HandModel) -> HandMotions:
    """One motion per joint, positive where it closes: towards the limit that is farther from zero."""
    low, high = np.clip(hand.limits[N_WRIST:].T, -np.pi, np.pi)
    near, far = np.sort(np.abs([low, high]), axis=0)
    closing = np.where(high >= -low, 1.0, -1.0)
    flexions = far > _FLEXION * near
    palmar = _pads(hand, closing, flexions)
    mean = np.where(flexions, _CLOSED * far, 0.0)
    deviation = np.maximum(_SPAN * (high - low), np.radians(1.0))
    return HandMotions(np.diag(closing), palmar, mean, np.diag(deviation), flexions, _opposing(hand, palmar), 0.0)


def _pads(hand: HandModel, closing: Array, flexions: Array) -> Array:
    """(P, 3): unit direction in which each part moves as its finger closes, in its own frame; the palm has the fingers'
    mean."""
    chain, layout = hand.chain, hand.layout
    zero = np.zeros((1, layout.n_joints))
    R, t = (values[0] for values in chain.part_frames(np.eye(3)[None], np.zeros((1, 3)), zero))
    axes, points = chain.joint_axes(R[None], zero)[0], chain.keypoints(R[None], t[None])[0]
    pads_H = np.zeros((layout.n_parts, 3))
    for finger in layout.fingers:
        closes = np.zeros(3)
        for part in finger.parts:
            for joint in chain.joints_of[part].tolist():
                if flexions[joint] or not closes.any():
                    closes = closing[joint] * axes[joint]
            bone = points[finger.keypoints[-1]] - t[part]
            pads_H[part] = np.cross(closes, bone)
    pads_H[0] = sum((pads_H[finger.parts[0]] for finger in layout.fingers), start=np.zeros(3))
    pads = np.matmul(np.swapaxes(R, 1, 2), pads_H[..., None])[..., 0]
    return np.asarray(pads / np.maximum(np.linalg.norm(pads, axis=1, keepdims=True), 1e-9))


def _opposing(hand: HandModel, palmar: Array) -> int:
    """Index of the finger called thumb, else of the one whose root is farthest from the others'."""
    layout = hand.layout
    if layout.thumb is not None:
        return layout.thumb
    roots = hand.offsets[[finger.parts[0] for finger in layout.fingers]]
    apart = np.linalg.norm(roots[:, None] - roots[None], axis=2).sum(axis=1)
    return int(apart.argmax())
