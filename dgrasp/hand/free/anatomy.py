"""Anatomy of the free hand: bones, joints and limits of a right hand of our own, from published anthropometry.

It has the 16 parts and 21 key points of `dgrasp.hand.mano.skeleton` and depends on no licensed hand model;
`dgrasp.hand.free.make_skin` lays a skin around it, and `dgrasp.hand.free.hand` makes a URDF from that.

Wrist frame: origin at the wrist's centre of rotation; the fingers point along -x, the palm faces -y, the thumb
is on the +z side. At the zero pose the hand is flat, its fingers straight and slightly spread, and every joint
frame is parallel to the wrist frame, so a positive rotation about z flexes a finger towards the palm and a
positive rotation about y moves it towards the thumb's side. A joint is three revolute joints in the order x, y, z.

Sources
- Bone lengths and the soft tissue of the tips: means of 66 adults in Buryanov and Kotiuk, "Proportions of hand
  segments", Int. J. Morphol. 28(3), 2010, table I. They run from joint space to joint space; the joint centres lie
  a few mm closer to the wrist at both ends, which leaves the distances nearly as they are.
- Hand breadth: mean of men and women in Greiner, "Hand anthropometry of U.S. Army personnel", 1991.
- Wrist: the carpus is as high as 0.54 of the third metacarpal (Youm et al., J. Bone Joint Surg. 60-A, 1978), and
  the centre of rotation lies in the head of the capitate, here at three quarters of that height.
- Limits: joint motion norms of the American Academy of Orthopaedic Surgeons, 1965, rounded; the thumb's base after
  Cooney et al., J. Bone Joint Surg. 63-A, 1981 (total ranges: flexion 53, abduction 42, rotation 17 deg), here
  counted from the zero pose, where the thumb is stretched out, and the rotation to both sides. All
  are widened by `SLACK_DEG`; motions that anatomy couples or allows only passively have small ranges of their own.
- Radii and the places of the metacarpals' bases are our own choice, for a hand of this size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dgrasp.hand.mano.skeleton import FINGERS, PARTS
from dgrasp.types import Array

HAND_BREADTH = 0.085
"""m, across the four knuckles."""

CARPAL_HEIGHT = 0.54 * 0.0646
"""m, from the radius to the base of the third metacarpal."""

METACARPALS = {"index": 0.0681, "middle": 0.0646, "ring": 0.0580, "little": 0.0537}
"""Lengths in m. The thumb's metacarpal moves, so it is in `BONES`."""

BONES = {
    "index": (0.0398, 0.0224, 0.0158 + 0.0038),
    "middle": (0.0446, 0.0263, 0.0174 + 0.0040),
    "ring": (0.0414, 0.0257, 0.0173 + 0.0040),
    "little": (0.0327, 0.0181, 0.0160 + 0.0037),
    "thumb": (0.0462, 0.0316, 0.0217 + 0.0057),
}
"""Lengths in m from joint to joint and, last, from joint to skin of the tip: bone plus soft tissue."""

RADII = {
    "index": (0.0095, 0.0085, 0.0075),
    "middle": (0.0095, 0.0085, 0.0075),
    "ring": (0.0090, 0.0080, 0.0070),
    "little": (0.0080, 0.0070, 0.0065),
    "thumb": (0.0125, 0.0105, 0.0095),
}
"""Radii in m about each joint; the skin scales its profiles by them."""

METACARPAL_BASES = {"index": (0.005, 0.015), "middle": (0.0, 0.0), "ring": (0.001, -0.013), "little": (0.004, -0.025)}
"""(x towards the wrist, z) in m, relative to the base of the third metacarpal."""

KNUCKLE_DROP = {"index": 0.002, "middle": 0.0, "ring": 0.002, "little": 0.005}
"""How far in m the knuckles lie below the third one, towards the palm's side: the transverse arch."""

SPREAD_DEG = {"index": 4.0, "middle": 0.0, "ring": -4.0, "little": -9.0}
"""Directions of the straight fingers, degrees from -x towards the thumb's side."""

THUMB_BASE = (-0.018, -0.012, 0.024)
"""Joint of the thumb's metacarpal in the wrist frame, m."""
THUMB_RADIAL_DEG, THUMB_PALMAR_DEG = 42.0, 18.0
"""Direction of the straight thumb: degrees from -x towards +z, and out of the palm's plane towards -y."""
THUMB_PRONATION_DEG = 45.0
"""Flexion plane of the thumb's two outer joints: 0 would close it towards the palm's normal, 90 across the palm."""

SLACK_DEG = 10.0
"""Added to both ends of every anatomical range below."""

Ranges = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""Degrees, before slack: twist about the bone, to the side, and flexion."""

FINGER_RANGES: tuple[Ranges, Ranges, Ranges] = (
    ((-5, 5), (-20, 20), (-20, 90)),
    ((0, 0), (0, 0), (0, 100)),
    ((0, 0), (0, 0), (-5, 80)),
)
THUMB_RANGES: tuple[Ranges, Ranges, Ranges] = (
    ((-17, 17), (-10, 42), (-10, 53)),
    ((-5, 5), (-10, 10), (-5, 50)),
    ((0, 0), (0, 0), (-15, 80)),
)


@dataclass(frozen=True)
class HandPart:
    """One rigid part. offset: (3,) m, its frame's origin in the parent part's frame; they are parallel at zero pose.

    limits: (3, 2) rad for the rotations about x, y, z.
    """

    name: str
    parent: str
    offset: Array
    limits: Array


def knuckles() -> dict[str, Array]:
    """(3,) m for each finger except the thumb: the joint between metacarpal and finger, in the wrist frame.

    The knuckles share the hand's breadth in proportion to the fingers' radii, the third one straight ahead.
    """
    width = {finger: HAND_BREADTH * RADII[finger][0] / sum(RADII[f][0] for f in METACARPALS) for finger in METACARPALS}
    z = {"middle": 0.0}
    z["index"] = (width["middle"] + width["index"]) / 2
    z["ring"] = -(width["middle"] + width["ring"]) / 2
    z["little"] = z["ring"] - (width["ring"] + width["little"]) / 2
    found = {}
    for finger, length in METACARPALS.items():
        base_x, base_z = METACARPAL_BASES[finger]
        drop = KNUCKLE_DROP[finger]
        reach = math.sqrt(length**2 - (z[finger] - base_z) ** 2 - drop**2)
        found[finger] = np.array([-0.75 * CARPAL_HEIGHT + base_x - reach, -drop, z[finger]])
    return found


def finger_direction(finger: str) -> Array:
    """(3,) unit vector of the straight finger at the zero pose, wrist frame."""
    if finger == "thumb":
        radial, palmar = math.radians(THUMB_RADIAL_DEG), math.radians(THUMB_PALMAR_DEG)
        in_plane = math.cos(palmar)
        return np.array([-in_plane * math.cos(radial), -math.sin(palmar), in_plane * math.sin(radial)])
    spread = math.radians(SPREAD_DEG[finger])
    return np.array([-math.cos(spread), 0.0, math.sin(spread)])


def anatomical_axes(finger: str, segment: int, bone: Array) -> Array:
    """(3, 3) rows: the axes of twist, of motion to the side and of flexion at the zero pose, wrist frame."""
    to_palm = np.cross(bone, [0.0, -1.0, 0.0])
    to_palm /= np.linalg.norm(to_palm)
    if finger != "thumb":
        return np.stack([-bone, np.cross(bone, to_palm), to_palm])
    across = np.cross(to_palm, bone)
    # Turning about `across` closes the thumb across the palm; turning about `to_palm` lifts it in front of the palm.
    if segment == 0:
        return np.stack([-bone, to_palm, across])
    pronation = math.radians(THUMB_PRONATION_DEG)
    flexion = math.cos(pronation) * to_palm + math.sin(pronation) * across
    return np.stack([-bone, np.cross(bone, flexion), flexion])


def anatomical_limits(finger: str, segment: int, bone: Array) -> Array:
    """(3, 2) rad: the smallest box of x, y, z rotations that holds every motion of the anatomical ranges.

    bone (3,): unit vector along the segment (0 proximal to 2 distal) at the zero pose, wrist frame of a right hand.
    """
    ranges = (THUMB_RANGES if finger == "thumb" else FINGER_RANGES)[segment]
    widened = np.radians([(low - SLACK_DEG, high + SLACK_DEG) for low, high in ranges])
    shares = anatomical_axes(finger, segment, bone)[:, :, None] * widened[:, None, :]
    return np.stack([shares.min(axis=2).sum(axis=0), shares.max(axis=2).sum(axis=0)], axis=1)


def hand_parts() -> tuple[HandPart, ...]:
    """The 16 parts in the order of `skeleton.PARTS`."""
    full_turn = np.tile([-math.pi, math.pi], (3, 1))
    parts = [HandPart("palm", "world", np.zeros(3), full_turn)]
    bases = {**knuckles(), "thumb": np.array(THUMB_BASE)}
    for finger in FINGERS:
        direction, offset, parent = finger_direction(finger), bases[finger], "palm"
        for segment, length in enumerate(BONES[finger]):
            name = PARTS[1 + 3 * FINGERS.index(finger) + segment]
            # The fingers' small spread is left out of their axes.
            bone = direction if finger == "thumb" else np.array([-1.0, 0.0, 0.0])
            parts.append(HandPart(name, parent, offset, anatomical_limits(finger, segment, bone)))
            offset, parent = direction * length, name
    return tuple(parts)
