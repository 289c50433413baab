"""Inverse kinematics for many hands at once: wrists and finger angles that bring key points to given places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.hand.layout import N_WRIST
from dgrasp.hand.model import HandModel
from dgrasp.types import Array

STAY = 0.003
"""m per rad. Cost of a joint angle's change from its start, relative to a key point's distance."""
ITERATIONS = 20
_SMALL = 1e-10


@dataclass(frozen=True, eq=False)
class KeypointFit:
    """Fitted hands: T_AH (N, 4, 4), hand_pose (N, J) rad, and their key points (N, K, 3) m, all in frame A."""

    T_AH: Array
    hand_pose: Array
    joints: Array


def fit_keypoints(hand: HandModel, T_AH: Array, hand_pose: Array, targets: Array) -> KeypointFit:
    """Fit hands to key points `targets` (N, K, 3) m in frame A, from wrists T_AH (N, 4, 4) and poses (N, J) rad.

    Minimises the sum of |x_k - target_k|^2 over the key points plus |STAY * (q - q_start)|^2 over the finger angles, by
    `ITERATIONS` Levenberg-Marquardt steps with the exact Jacobian. Angles stay within the joint limits; those that
    start outside move no farther out. Joints that follow others are tied from the start on.
    """
    hand_pose = hand.ties.coordinates(hand_pose)
    state = _Chains(hand, T_AH[:, :3, :3].copy(), T_AH[:, :3, 3].copy(), hand_pose.copy())
    limits = hand.limits[N_WRIST:].T
    low, high = np.minimum(limits[0], hand_pose), np.maximum(limits[1], hand_pose)
    damping: Array = np.full(len(targets), 1e-6)
    cost = _cost(state, targets, hand_pose)
    n, size = len(targets), 3 * hand.layout.n_keypoints
    diagonal = np.arange(hand.layout.n_dof)
    for _ in range(ITERATIONS):
        jacobian = state.jacobian().reshape(n, size, -1)
        residual = (state.joints - targets).reshape(n, size, 1)
        normal = np.matmul(jacobian.swapaxes(1, 2), jacobian)
        slope = np.matmul(jacobian.swapaxes(1, 2), residual)[..., 0]
        slope[:, N_WRIST:] += STAY**2 * (state.pose - hand_pose)
        normal[:, diagonal[N_WRIST:], diagonal[N_WRIST:]] += STAY**2
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
    """(N,) m^2: the cost that `fit_keypoints` minimises."""
    near: Array = ((state.joints - targets) ** 2).sum(axis=(1, 2))
    return near + (STAY * (state.pose - start) ** 2 * STAY).sum(axis=1)


class _Chains:
    """N hands with the frames of their parts: R (N, 3, 3), wrist (N, 3), pose (N, J)."""

    def __init__(self, hand: HandModel, R: Array, wrist: Array, pose: Array) -> None:
        self.hand, self.R, self.wrist, self.pose = hand, R, wrist, pose
        self._frames, self._origins = hand.chain.part_frames(R, wrist, pose)
        self.joints = hand.chain.keypoints(self._frames, self._origins)

    def jacobian(self) -> Array:
        """(N, K, 3, D): derivatives of the key points by the coordinates.

        The coordinates are the wrist's translation, its rotation vector (frame A), and the finger angles.
        """
        chain, layout = self.hand.chain, self.hand.layout
        J = np.zeros((len(self.pose), layout.n_keypoints, 3, layout.n_dof))
        J[..., :3] = np.eye(3)
        arm = self.joints - self.wrist[:, None]
        for k, axis in enumerate(np.eye(3)):
            J[..., 3 + k] = np.cross(axis, arm)
        axes = chain.joint_axes(self._frames, self.pose)
        for part in range(1, layout.n_parts):
            moved = chain.beyond[part]
            arm = self.joints[:, moved] - self._origins[:, None, part]
            for joint in chain.joints_of[part].tolist():
                J[..., N_WRIST + joint][:, moved] = np.cross(axes[:, None, joint], arm)
        if len(self.hand.ties.followers):
            J[..., N_WRIST:] = J[..., N_WRIST:] @ self.hand.ties.matrix
        return J

    def moved(self, step: Array, low: Array, high: Array) -> _Chains:
        """The hands after a step (N, D) in the Jacobian's coordinates; angles are clipped to low and high (N, J)."""
        from scipy.spatial.transform import Rotation

        R = Rotation.from_rotvec(step[:, 3:6]).as_matrix() @ self.R
        pose = self.hand.ties.coordinates(np.clip(self.pose + step[:, N_WRIST:], low, high))
        return _Chains(self.hand, R, self.wrist + step[:, :3], pose)

    def where(self, chosen: Array, other: _Chains) -> _Chains:
        """The hands of `other` where chosen (N,) bool, else these."""
        R = np.where(chosen[:, None, None], other.R, self.R)
        wrist, pose = (np.where(chosen[:, None], b, a) for a, b in ((self.wrist, other.wrist), (self.pose, other.pose)))
        return _Chains(self.hand, R, wrist, pose)
