"""Hands with MANO's joints: five fingers of three parts, each part turned by three joints about x, y and z."""

from __future__ import annotations

import numpy as np

from dgrasp.hand.free.skin import rest_pose
from dgrasp.hand.kinematics import Kinematics
from dgrasp.hand.layout import N_WRIST, HandNames, Side
from dgrasp.hand.mano.model import MIRROR_ANGLES
from dgrasp.hand.mano.skeleton import DOF_NAMES, KEYPOINTS, N_DOF, N_PARTS, PART_PARENT, PARTS
from dgrasp.types import Array
from raisim_like.urdf import UrdfModel

MANO_NAMES = HandNames(DOF_NAMES[N_WRIST:], PARTS, KEYPOINTS)
"""The names of such a hand's joints, parts and key points, whatever its URDF calls them."""


def difference_from_mano(urdf: UrdfModel) -> str | None:
    """How the finger joints of a URDF differ from MANO's, as a text for messages; None if they do not."""
    if urdf.dof != N_DOF:
        return f"a hand has {N_DOF} joints (3 translations, 16 x 3 rotations), found {urdf.dof}"
    for i, link in enumerate(urdf.links[N_WRIST:], start=N_WRIST):
        if link.kind != "revolute" or not np.array_equal(link.axis, np.eye(3)[i % 3]):
            return f"joint {i} ({link.joint}) must be revolute about axis {'xyz'[i % 3]}"
        if not np.allclose(link.origin[:3, :3], np.eye(3), atol=1e-9):
            return f"joint {i} ({link.joint}) is rotated; joint frames must be parallel at zero"
        if i % 3 and np.abs(link.origin[:3, 3]).max() > 1e-12:
            return f"joint {i} ({link.joint}) must share its origin with the joint before it"
        expected = 5 + 3 * PART_PARENT[i // 3 - 1]
        if i % 3 == 0 and link.parent != expected:
            return (f"joint {i} ({link.joint}) must hang on link {urdf.links[expected].name}: "
                    "fingers in the order index, middle, ring, little, thumb")
    for part in range(3, N_PARTS, 3):
        distal = 3 * part + 5
        marks = sum(i == distal and name != urdf.links[distal].name for name, (i, _) in urdf.frames.items())
        if marks != 1:
            return (f"link {urdf.links[distal].name} needs one fixed child link that marks the fingertip, "
                    f"found {marks}")
    return None


def mano_kinematics(offsets: Array) -> Kinematics:
    """The kinematics of such a hand from its parts' offsets (16, 3) m alone, with the fingertips at the last joints."""
    joints = N_DOF - N_WRIST
    owners = [0 if point == "wrist" else PARTS.index(point.replace("tip", "distal")) for point in KEYPOINTS]
    return Kinematics(
        np.array(PART_PARENT), np.asarray(offsets, dtype=float), np.repeat(np.arange(1, N_PARTS), 3),
        np.tile(np.eye(3), (joints // 3, 1)), np.tile(np.eye(3), (joints, 1, 1)), np.array(owners),
        np.zeros((len(KEYPOINTS), 3)),
    )  # fmt: skip


def mano_rest(side: Side) -> Array:
    """(45,) rad: finger angles at rest. They are the mean pose of the free hand's model, in place of MANO's."""
    angles = rest_pose()
    return angles if side == "right" else angles * np.tile(MIRROR_ANGLES, len(angles) // 3)
