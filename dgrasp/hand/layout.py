"""Names of a hand's joints, parts, key points and fingers, in the orders of all arrays about the hand.

No number here belongs to one particular hand. `dgrasp.hand.load` makes a `HandLayout` from a URDF.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

Side = Literal["right", "left"]

WRIST_JOINTS = (*(f"wrist_t{axis}" for axis in "xyz"), *(f"wrist_r{axis}" for axis in "xyz"))
"""The first six coordinates of every hand: the wrist's translation, m, and its intrinsic XYZ Euler angles, rad, both
relative to the wrist frame H0 in which an episode starts."""
N_WRIST = len(WRIST_JOINTS)


@dataclass(frozen=True)
class HandNames:
    """The names that label files store of a hand, one per column of their arrays.

    joints: the finger joints, without the wrist's six. parts: those that can touch. keypoints: the wrist comes first.
    """

    joints: tuple[str, ...]
    parts: tuple[str, ...]
    keypoints: tuple[str, ...]


@dataclass(frozen=True)
class Finger:
    """One branch of the hand, from the palm outwards.

    joints: indices into the finger joints (a label's `hand_pose`). parts, keypoints: indices into those of the hand;
    the key points are the origin of each part and, after an outermost part, its tip.
    """

    name: str
    joints: tuple[int, ...]
    parts: tuple[int, ...]
    keypoints: tuple[int, ...]


@dataclass(frozen=True)
class HandLayout:
    """Names and indices of a hand with J finger joints, P parts and K key points.

    names: see `HandNames`; the first part is the palm, the first key point the wrist. fingers: in the order of their
    joints. tips: key points at the ends of the fingers. thumb: the finger that opposes the others, None unless exactly
    one finger is called a thumb. side: which human hand it resembles; None for a hand without a mirror image.
    """

    names: HandNames
    fingers: tuple[Finger, ...]
    tips: tuple[int, ...]
    thumb: int | None = None
    side: Side | None = None

    @property
    def n_joints(self) -> int:
        """J, the number of finger joints."""
        return len(self.names.joints)

    @property
    def n_dof(self) -> int:
        """D, the number of generalised coordinates: the wrist's six and the finger joints."""
        return N_WRIST + self.n_joints

    @property
    def n_parts(self) -> int:
        """P, the number of parts."""
        return len(self.names.parts)

    @property
    def n_keypoints(self) -> int:
        """K, the number of key points."""
        return len(self.names.keypoints)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all generalised coordinates, the wrist's first."""
        return (*WRIST_JOINTS, *self.names.joints)

    @cached_property
    def finger_of_part(self) -> tuple[int, ...]:
        """(P,) index of the finger that each part belongs to; -1 for the palm."""
        owner = {part: index for index, finger in enumerate(self.fingers) for part in finger.parts}
        return tuple(owner.get(part, -1) for part in range(self.n_parts))

    @cached_property
    def outer_parts(self) -> tuple[int, ...]:
        """The last part of each finger."""
        return tuple(finger.parts[-1] for finger in self.fingers)
