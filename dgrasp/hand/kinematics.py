"""Forward kinematics of a hand from its URDF, for N hands at once.

Each joint has one axis. Joints that share an origin turn one part. If a part has three joints about x, y and z, as in
MANO's hand, their rotation is computed from intrinsic XYZ Euler angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dgrasp.types import Array
from raisim_like.rotations import matrix_from_euler, matrix_from_rotation_vector


@dataclass(frozen=True, eq=False)
class Kinematics:
    """A tree of P parts with J finger joints and K key points; part 0 is the palm, whose frame is the wrist's, H.

    parents (P,): index of each part's parent, -1 for the palm. offsets (P, 3) m: each part's origin in the frame of its
    parent. joint_parts (J,): the part that each joint turns; several joints of one part turn it one after the other.
    axes (J, 3): unit axes in the joints' own frames. joint_frames (J, 3, 3): rotation from a joint's frame to that of
    the joint before it in the same part, or of the parent part. keypoint_parts (K,): the part to which each key point
    is fixed. keypoint_offsets (K, 3) m: the key point in that part's frame.
    """

    parents: Array
    offsets: Array
    joint_parts: Array
    axes: Array
    joint_frames: Array
    keypoint_parts: Array
    keypoint_offsets: Array

    def part_turns(self, pose: Array) -> Array:
        """(N, P - 1, 3, 3): rotation of each part except the palm relative to its parent, for joint angles (N, J)."""
        n, count = len(pose), len(self.parents) - 1
        if self.all_euler:
            return matrix_from_euler(pose.reshape(n, count, 3))
        out = np.empty((n, count, 3, 3))
        for part in range(1, count + 1):
            joints = self.joints_of[part]
            if self._is_euler(joints):
                out[:, part - 1] = matrix_from_euler(pose[:, joints])
                continue
            turn = np.broadcast_to(np.eye(3), (n, 3, 3))
            for joint in joints.tolist():
                turn = turn @ self.joint_frames[joint]
                turn = turn @ matrix_from_rotation_vector(pose[:, joint, None] * self.axes[joint])
            out[:, part - 1] = turn
        return out

    def part_frames(self, R_WH: Array, wrist_W: Array, pose: Array) -> tuple[Array, Array]:
        """World rotations (N, P, 3, 3) and origins (N, P, 3) of the parts.

        R_WH (N, 3, 3), wrist_W (N, 3) m: the wrists. pose (N, J) rad.
        """
        n, count = len(pose), len(self.parents)
        turns = self.part_turns(pose)
        R, t = np.empty((n, count, 3, 3)), np.empty((n, count, 3))
        R[:, 0], t[:, 0] = R_WH, wrist_W
        for parts, parents in self._levels:
            above = R[:, parents]
            t[:, parts] = t[:, parents] + np.matmul(above, self.offsets[parts, :, None])[..., 0]
            R[:, parts] = np.matmul(above, turns[:, parts - 1])
        return R, t

    def keypoints(self, R: Array, t: Array) -> Array:
        """(N, K, 3) m: the key points for parts at R (N, P, 3, 3), t (N, P, 3), in the same frame."""
        out: Array = t[:, self.keypoint_parts]
        away = self._away
        turned = np.matmul(R[:, self.keypoint_parts[away]], self.keypoint_offsets[away, :, None])[..., 0]
        out[:, away] += turned
        return out

    def joint_axes(self, R: Array, pose: Array) -> Array:
        """(N, J, 3): the joints' axes, in R's frame, for parts turned to R (N, P, 3, 3) by joint angles (N, J)."""
        out = np.empty((len(pose), len(self.axes), 3))
        for part in range(1, len(self.parents)):
            joints = self.joints_of[part]
            above = R[:, self.parents[part]]
            for k, joint in enumerate(joints.tolist()):
                frame = above @ self._turned_before(pose, joints, k) @ self.joint_frames[joint]
                out[:, joint] = frame @ self.axes[joint]
        return out

    def _turned_before(self, pose: Array, joints: Array, k: int) -> Array:
        """(N, 3, 3): the rotation that the first k of a part's joints make."""
        if self._is_euler(joints):
            angles = pose[:, joints].copy()
            angles[:, k:] = 0.0
            return matrix_from_euler(angles)
        turn = np.broadcast_to(np.eye(3), (len(pose), 3, 3))
        for joint in joints[:k].tolist():
            about = matrix_from_rotation_vector(pose[:, joint, None] * self.axes[joint])
            turn = turn @ self.joint_frames[joint] @ about
        return turn

    @cached_property
    def joints_of(self) -> tuple[Array, ...]:
        """For each part, the indices of the joints that turn it."""
        return tuple(np.flatnonzero(self.joint_parts == part) for part in range(len(self.parents)))

    @cached_property
    def beyond(self) -> tuple[Array, ...]:
        """For each part, the key points that move when it turns: its own, except at its origin, and those beyond it."""
        found = []
        for part in range(len(self.parents)):
            own = {part}
            for other in range(part + 1, len(self.parents)):
                if int(self.parents[other]) in own:
                    own.add(other)
            moves = np.isin(self.keypoint_parts, list(own))
            moves &= (self.keypoint_parts != part) | (self.keypoint_offsets != 0.0).any(axis=1)
            found.append(np.flatnonzero(moves))
        return tuple(found)

    def _is_euler(self, joints: Array) -> bool:
        return bool(
            len(joints) == 3 and np.array_equal(self.axes[joints], np.eye(3))
            and np.allclose(self.joint_frames[joints], np.eye(3), rtol=0.0, atol=1e-9)
        )  # fmt: skip

    @cached_property
    def all_euler(self) -> bool:
        in_order = np.array_equal(self.joint_parts, np.repeat(np.arange(1, len(self.parents)), 3))
        return in_order and all(map(self._is_euler, self.joints_of[1:]))

    @cached_property
    def _away(self) -> Array:
        """Key points that lie away from their part's origin."""
        return np.flatnonzero((self.keypoint_offsets != 0.0).any(axis=1))

    @cached_property
    def _levels(self) -> tuple[tuple[Array, Array], ...]:
        """Parts grouped by their number of ancestors, without the palm; each group with its parents."""
        depth = [0]
        for parent in self.parents[1:].tolist():
            depth.append(depth[parent] + 1)
        levels = [np.flatnonzero(np.array(depth) == d) for d in range(1, max(depth) + 1)]
        return tuple((parts, self.parents[parts]) for parts in levels)
