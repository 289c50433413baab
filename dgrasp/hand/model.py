"""The hand as the environment sees it: layout, kinematics, limits and parts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dgrasp.hand.kinematics import Kinematics
from dgrasp.hand.layout import N_WRIST, HandLayout
from dgrasp.types import Array
from raisim_like.mimic import Mimic, Ties
from raisim_like.rotations import matrix_from_euler
from raisim_like.urdf import UrdfModel


@dataclass(frozen=True, eq=False)
class HandModel:
    """A hand of a URDF with D generalised coordinates: the wrist's six (`layout.WRIST_JOINTS`), then J finger joints.

    layout: names and indices. chain: forward kinematics. limits: (D, 2) m or rad. part_links: (P,) index of each part's
    moving link in the URDF. rest: (J,) rad, the finger angles of a hand at rest, within the limits. carried_mass: hand
    mass (kg) that an unmodelled arm supports (`load.load_hand`).
    """

    id: str
    urdf: UrdfModel
    layout: HandLayout
    chain: Kinematics
    limits: Array
    part_links: Array
    rest: Array
    carried_mass: float = 0.0

    @cached_property
    def ties(self) -> Ties:
        """The finger joints that follow others; its indices and arrays are those of poses (J,)."""
        mimics = [link.mimic for link in self.urdf.links[N_WRIST:]]
        return Ties.of([m and Mimic(m.leader - N_WRIST, m.multiplier, m.offset) for m in mimics])

    @property
    def offsets(self) -> Array:
        """(P, 3) m: the origin of each part in the frame of its parent part."""
        return self.chain.offsets

    @property
    def tips(self) -> Array:
        """(number of tips, 3) m: the fingertips in the frames of the fingers' outermost parts."""
        return np.asarray(self.chain.keypoint_offsets[list(self.layout.tips)])

    def forward(self, gc: Array, R_WH0: Array, wrist_start_W: Array) -> tuple[Array, Array]:
        """Wrist rotations (N, 3, 3) and key points (N, K, 3) m, world, for coordinates gc (N, D).

        R_WH0 (N, 3, 3), wrist_start_W (N, 3): the frame H0 that gc[:, :6] is relative to.
        """
        R_WH = np.matmul(R_WH0, matrix_from_euler(gc[:, 3:N_WRIST]))
        wrist = wrist_start_W + np.matmul(R_WH0, gc[:, :3, None])[..., 0]
        return R_WH, self.chain.keypoints(*self.chain.part_frames(R_WH, wrist, gc[:, N_WRIST:]))

    def keypoints_at(self, T_WH: Array, hand_pose: Array) -> Array:
        """(N, K, 3) m: key points, world, of hands with wrists T_WH (N, 4, 4) and finger angles hand_pose (N, J)."""
        return self.chain.keypoints(*self.part_poses(T_WH, hand_pose))

    def part_poses(self, T_WH: Array, hand_pose: Array) -> tuple[Array, Array]:
        """World rotations (N, P, 3, 3) and origins (N, P, 3) of the parts, for T_WH (N, 4, 4), hand_pose (N, J)."""
        return self.chain.part_frames(T_WH[:, :3, :3], T_WH[:, :3, 3], hand_pose)
