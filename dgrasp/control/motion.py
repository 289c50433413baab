"""Motion synthesis: the wrist carries the object to a 6D target in closed loop (paper, 3.3; supplement, A.2)."""

from __future__ import annotations

from typing import Literal

import numpy as np

from dgrasp.config.sections import ActionConfig, MotionConfig
from dgrasp.control.controllers import HOLD_KP_POSITION
from dgrasp.hand.layout import N_WRIST, HandLayout
from dgrasp.types import Array, SceneState
from raisim_like.rotations import (
    euler_from_matrix,
    matrix_from_rotation_vector,
    rotate,
    rotate_back,
    rotation_vector,
)

Fingers = Literal["policy", "target", "pose"]
"""What moves the fingers during the motion: the policy, or nothing: they keep their PD targets or their pose."""


class MotionSynthesis:
    """T_pd = T_h + beta * (T_g - T_o), recomputed in every control step; the policy controls the fingers.

    The targets are `state.R_WG` and `state.target_pos_W`, which may move. As in the authors' code, beta grows in equal
    steps, so that the object does not start with a jerk.
    """

    kp_position = HOLD_KP_POSITION

    def __init__(
        self, action: ActionConfig, motion: MotionConfig, hand: HandLayout, fingers: Array | None = None
    ) -> None:
        """fingers: (N, J) targets to hold the fingers at, instead of the policy's (the baseline "static grasp")."""
        self.sigma: Array = np.zeros(hand.n_dof)
        if fingers is None:
            self.sigma[N_WRIST:] = action.sigma_fingers
        self._motion = motion
        self._fingers = None if fingers is None else fingers.copy()
        self._steps = 0

    def bias(self, state: SceneState, goal: object, out: Array) -> None:
        """Write q_b into out (N, D). Call it once per control step."""
        out[:] = state.gc if self._fingers is None else np.concatenate([state.gc[:, :N_WRIST], self._fingers], axis=1)
        m, n = self._motion, len(out)
        beta_position = m.beta_position * min(1.0, self._steps / m.ramp_position)
        beta_rotation = m.beta_rotation * min(1.0, self._steps / m.ramp_rotation)
        out[:, :N_WRIST] = wrist_target(state, np.full(n, beta_position), np.full(n, beta_rotation))
        self._steps += 1


def wrist_target(state: SceneState, beta_position: Array, beta_rotation: Array) -> Array:
    """(N, 6) the wrist's coordinates, relative to H0, that move the object to its target by the shares beta (N,).

    The object is taken to be rigidly fixed in the hand. It moves straight towards its target's position and turns about
    its own origin, about the axis of the remaining rotation. If both beta are 1, it reaches the target.
    """
    to_go = rotation_vector(np.matmul(state.R_WG, np.swapaxes(state.R_WO, 1, 2)))
    turn = matrix_from_rotation_vector(beta_rotation[:, None] * to_go)
    object_pos = state.object_pos_W + beta_position[:, None] * (state.target_pos_W - state.object_pos_W)
    wrist_pos = object_pos + rotate(turn, state.joints_W[:, 0] - state.object_pos_W)
    out = np.empty((len(state.gc), 6))
    out[:, :3] = rotate_back(state.R_WH0, wrist_pos - state.wrist_start_W)
    R_H0H = np.matmul(np.swapaxes(state.R_WH0, 1, 2), np.matmul(turn, state.R_WH))
    out[:, 3:] = nearest_euler(R_H0H, state.gc[:, 3:6])
    return out


LOCK = 1e-9
"""Threshold of 1 - |sin b|. Below it, the first and third angles turn about the same axis."""


def nearest_euler(R: Array, near: Array) -> Array:
    """Intrinsic XYZ angles (N, 3) of matrices (N, 3, 3): of all solutions, the ones nearest to `near` (N, 3).

    A rotation has two sets of angles, (a, b, c) and (a + pi, pi - b, c + pi), each up to whole turns. A joint that
    followed the principal angles would have to jump. At gimbal lock, all angles with the same a + c (or a - c) are
    solutions.
    """
    first = euler_from_matrix(R)
    second = np.array([np.pi, np.pi, np.pi]) + first * np.array([1.0, -1.0, 1.0])
    first, second = (near + _wrapped(angles - near) for angles in (first, second))
    closer = ((second - near) ** 2).sum(axis=1) < ((first - near) ** 2).sum(axis=1)
    out = np.where(closer[:, None], second, first)
    locked = 1.0 - np.abs(R[:, 0, 2]) < LOCK
    if locked.any():
        # At gimbal lock the principal third angle is 0, so a alone gives a + c (b = pi/2) or a - c (b = -pi/2).
        side = np.sign(R[locked, 0, 2])
        a, c = near[locked, 0], near[locked, 2]
        half = _wrapped(first[locked, 0] + side * first[locked, 2] - a - side * c) / 2.0
        out[locked, 0], out[locked, 2] = a + half, c + side * half
    return np.asarray(out)


def _wrapped(angles: Array) -> Array:
    """Angles shifted by whole turns to be nearest to 0."""
    return np.asarray(angles - 2.0 * np.pi * np.round(angles / (2.0 * np.pi)))
