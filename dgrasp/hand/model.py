"""The hand as the environment sees it: forward kinematics, limits and parts, read from its URDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgrasp.errors import DataError
from dgrasp.hand.mano.skeleton import N_DOF, N_PARTS, PART_PARENT
from dgrasp.types import Array
from raisim_like.errors import UrdfError
from raisim_like.rotations import matrix_from_euler
from raisim_like.urdf import UrdfModel, read_urdf

_FIRST = np.array([1, 4, 7, 10, 13])
"""Indices of the five proximal parts; +1 and +2 are the middle and distal ones."""


@dataclass(frozen=True)
class HandModel:
    """A 51-DoF hand: 3 translations, then one intrinsic XYZ triple per part (wrist first).

    offsets: (16, 3) origin of each part in its parent part's frame. tips: (5, 3) fingertips in the distal
    parts' frames. limits: (51, 2). Parts move with the links `part_links` (16,) of the URDF.

    carried_mass: kg whose weight an arm is taken to carry, which is nothing that the joints model: all of the hand. 0
    for the authors' hand, whose palm has its mass on the first slider and hardly pulls the others down.
    """

    id: str
    urdf: UrdfModel
    offsets: Array
    tips: Array
    limits: Array
    part_links: Array
    carried_mass: float = 0.0

    def forward(self, gc: Array, R_WH0: Array, wrist_start_W: Array) -> tuple[Array, Array]:
        """Wrist rotations (N, 3, 3) and key points (N, 21, 3), world, of coordinates gc (N, 51).

        gc[:, :6] is relative to the initial wrist frame: translation in H0, then R_H0H as Euler angles.
        """
        n = len(gc)
        R = matrix_from_euler(gc[:, 3:].reshape(n, N_PARTS, 3))
        R_WH = np.matmul(R_WH0, R[:, 0])
        points = np.empty((n, 5, 4, 3))
        wrist = wrist_start_W + np.matmul(R_WH0, gc[:, :3, None])[..., 0]
        turn = np.broadcast_to(R_WH[:, None], (n, 5, 3, 3))
        at = np.broadcast_to(wrist[:, None], (n, 5, 3))
        for level in range(3):
            at = at + np.matmul(turn, self.offsets[_FIRST + level, :, None])[..., 0]
            turn = np.matmul(turn, R[:, _FIRST + level])
            points[:, :, level] = at
        points[:, :, 3] = at + np.matmul(turn, self.tips[..., None])[..., 0]
        joints = np.empty((n, 21, 3))
        joints[:, 0] = wrist
        joints[:, 1:] = points.reshape(n, 20, 3)
        return R_WH, joints


def load_hand(path: Path, hand_id: str) -> HandModel:
    """The hand of a URDF; a `DataError` says where it differs from the 51-DoF layout."""
    try:
        urdf = read_urdf(path)
    except UrdfError as error:
        raise DataError(str(error)) from None
    if urdf.dof != N_DOF:
        raise DataError(f"{path}: a hand has {N_DOF} joints (3 translations, 16 x 3 rotations), found {urdf.dof}")
    for i, link in enumerate(urdf.links):
        kind = "prismatic" if i < 3 else "revolute"
        if link.kind != kind or not np.array_equal(link.axis, np.eye(3)[i % 3]):
            raise DataError(f"{path}: joint {i} ({link.joint}) must be {kind} about axis {'xyz'[i % 3]}")
        if not np.allclose(link.origin[:3, :3], np.eye(3), atol=1e-9):
            raise DataError(f"{path}: joint {i} ({link.joint}) is rotated; joint frames must be parallel at zero")
        if (i % 3 or i < 6) and np.abs(link.origin[:3, 3]).max() > 1e-12:
            before = "the joint before it" if i else "the hand's base"
            raise DataError(f"{path}: joint {i} ({link.joint}) must share its origin with {before}")
        if i >= 6 and i % 3 == 0:
            expected = 5 + 3 * PART_PARENT[i // 3 - 1]
            if link.parent != expected:
                raise DataError(
                    f"{path}: joint {i} ({link.joint}) must hang on link {urdf.links[expected].name}: "
                    "fingers in the order index, middle, ring, little, thumb"
                )
    part_links = np.arange(N_PARTS) * 3 + 5
    offsets = np.array([urdf.links[3 + 3 * part].origin[:3, 3] for part in range(N_PARTS)])
    tips = []
    for finger in range(5):
        distal = int(part_links[3 + 3 * finger])
        fixed = [T for name, (i, T) in urdf.frames.items() if i == distal and name != urdf.links[distal].name]
        if len(fixed) != 1:
            raise DataError(
                f"{path}: link {urdf.links[distal].name} needs one fixed child link that marks the fingertip, "
                f"found {len(fixed)}"
            )
        tips.append(fixed[0][:3, 3])
    carried = urdf.mass if urdf.links[part_links[0]].mass > urdf.links[0].mass else 0.0
    return HandModel(hand_id, urdf, offsets, np.array(tips), urdf.joint_limits, part_links, carried)
