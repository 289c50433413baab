"""Inverse kinematics: wrist and finger angles that bring a hand's key points to given places, many hands at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.hand.mano.skeleton import N_DOF, N_KEYPOINTS, N_PARTS, PART_PARENT
from dgrasp.hand.model import HandModel
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_euler

STAY = 0.003
"""m per rad: how much a joint angle's change from where it started costs, against a key point's distance."""
ITERATIONS = 20
_SMALL = 1e-10


@dataclass(frozen=True, eq=False)
class KeypointFit:
    """Fitted hands: T_AH (N, 4, 4), hand_pose (N, 45) rad, and their key points (N, 21, 3) m, all in frame A."""

    T_AH: Array
    hand_pose: Array
    joints: Array


def fit_keypoints(hand: HandModel, T_AH: Array, hand_pose: Array, targets: Array) -> KeypointFit:
    """The hands nearest to key points `targets` (N, 21, 3) m in frame A, from wrists T_AH (N, 4, 4) and poses (N, 45).

    Minimises the sum of |x_k - target_k|^2 over the key points plus |STAY * (q - q_start)|^2 over the finger angles, by
    `ITERATIONS` steps of Levenberg and Marquardt with the exact Jacobian. Angles stay within the joint limits, and
    those that started outside move no farther out.
    """
    state = _Chains(hand, T_AH[:, :3, :3].copy(), T_AH[:, :3, 3].copy(), hand_pose.copy())
    limits = hand.limits[6:].T
    low, high = np.minimum(limits[0], hand_pose), np.maximum(limits[1], hand_pose)
    damping = np.full(len(targets), 1e-6)
    cost = _cost(state, targets, hand_pose)
    diagonal = np.arange(N_DOF)
    for _ in range(ITERATIONS):
        jacobian = state.jacobian().reshape(len(targets), 3 * N_KEYPOINTS, N_DOF)
        residual = (state.joints - targets).reshape(len(targets), 3 * N_KEYPOINTS, 1)
        normal = np.matmul(jacobian.swapaxes(1, 2), jacobian)
        slope = np.matmul(jacobian.swapaxes(1, 2), residual)[..., 0]
        slope[:, 6:] += STAY**2 * (state.pose - hand_pose)
        normal[:, diagonal[6:], diagonal[6:]] += STAY**2
        normal[:, diagonal, diagonal] += damping[:, None] + _SMALL
        step = -np.linalg.solve(normal, slope[..., None])[..., 0]
        tried = state.moved(step, low, high)
        tried_cost = _cost(tried, targets, hand_pose)
        better = tried_cost < cost
        state = state.where(better, tried)
        cost = np.where(better, tried_cost, cost)
        damping = np.where(better, damping / 5.0, damping * 5.0).clip(1e-9, 1e3)
    T = np.tile(np.eye(4), (len(targets), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = state.R, state.wrist
    return KeypointFit(T, state.pose, state.joints)


def _cost(state: _Chains, targets: Array, start: Array) -> Array:
    """(N,) m^2."""
    near: Array = ((state.joints - targets) ** 2).sum(axis=(1, 2))
    return near + (STAY * (state.pose - start) ** 2 * STAY).sum(axis=1)


class _Chains:
    """N hands with the axes that their joints turn about: R (N, 3, 3), wrist (N, 3), pose (N, 45)."""

    def __init__(self, hand: HandModel, R: Array, wrist: Array, pose: Array) -> None:
        self.hand, self.R, self.wrist, self.pose = hand, R, wrist, pose
        n = len(pose)
        angles = pose.reshape(n, N_PARTS - 1, 3)
        # Where part p turns from its parent, after its first, second and third angle.
        first, second = np.zeros_like(angles), np.zeros_like(angles)
        first[..., 0], second[..., :2] = angles[..., 0], angles[..., :2]
        turns = [matrix_from_euler(a) for a in (first, second, angles)]
        frames, self.origins = np.empty((n, N_PARTS, 3, 3)), np.empty((n, N_PARTS, 3))
        frames[:, 0], self.origins[:, 0] = R, wrist
        self.axes = np.empty((n, N_PARTS, 3, 3))
        for part in range(1, N_PARTS):
            above = frames[:, PART_PARENT[part]]
            self.origins[:, part] = self.origins[:, PART_PARENT[part]] + above @ hand.offsets[part]
            self.axes[:, part, 0] = above[:, :, 0]
            self.axes[:, part, 1] = (above @ turns[0][:, part - 1])[:, :, 1]
            self.axes[:, part, 2] = (above @ turns[1][:, part - 1])[:, :, 2]
            frames[:, part] = above @ turns[2][:, part - 1]
        self.joints = np.empty((n, N_KEYPOINTS, 3))
        self.joints[:, 0] = wrist
        for finger in range(5):
            own, parts = 1 + 4 * finger, slice(1 + 3 * finger, 4 + 3 * finger)
            self.joints[:, own : own + 3] = self.origins[:, parts]
            tip = frames[:, parts][:, 2] @ hand.tips[finger]
            self.joints[:, own + 3] = self.origins[:, parts][:, 2] + tip

    def jacobian(self) -> Array:
        """(N, 21, 3, 51): key points by the wrist's translation, its rotation vector (frame A), finger angles."""
        J = np.zeros((len(self.pose), N_KEYPOINTS, 3, N_DOF))
        J[..., :3] = np.eye(3)
        arm = self.joints - self.wrist[:, None]
        for k, axis in enumerate(np.eye(3)):
            J[..., 3 + k] = np.cross(axis, arm)
        for part in range(1, N_PARTS):
            finger, segment = divmod(part - 1, 3)
            # Only what lies beyond the joint moves.
            moved = slice(2 + 4 * finger + segment, 5 + 4 * finger)
            arm = self.joints[:, moved] - self.origins[:, None, part]
            for k in range(3):
                J[:, moved, :, 3 + 3 * part + k] = np.cross(self.axes[:, None, part, k], arm)
        return J

    def moved(self, step: Array, low: Array, high: Array) -> _Chains:
        """The hands after a step (N, 51) of the Jacobian's coordinates, the angles kept within low and high (N, 45)."""
        from scipy.spatial.transform import Rotation

        R = Rotation.from_rotvec(step[:, 3:6]).as_matrix() @ self.R
        return _Chains(self.hand, R, self.wrist + step[:, :3], np.clip(self.pose + step[:, 6:], low, high))

    def where(self, chosen: Array, other: _Chains) -> _Chains:
        """The other's hands where chosen (N,) bool, else these."""
        R = np.where(chosen[:, None, None], other.R, self.R)
        wrist, pose = (np.where(chosen[:, None], b, a) for a, b in ((self.wrist, other.wrist), (self.pose, other.pose)))
        return _Chains(self.hand, R, wrist, pose)
