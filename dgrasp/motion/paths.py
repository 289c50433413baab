"""Trajectories of the object: two that come with the project, and sampling of any trajectory."""

from __future__ import annotations

import numpy as np

from dgrasp.motion.targets import TargetSet
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_rotation_vector, transform

LIFT_S = 2.0
"""s that both trajectories take to lift the object."""
CIRCLE_RADIUS, CIRCLE_LIFT, CIRCLE_S = 0.1, 0.15, 6.0
"""Radius m, lift m, and s for one turn."""
POUR_ANGLE, POUR_LIFT, TILT_S, POUR_S = 1.2, 0.2, 2.5, 1.0
"""Tilt rad, lift m, s to tilt and again to return, and s in between."""


def sample(time: Array, T: Array, period: float) -> Array:
    """(P, 4, 4): poses at the end of each control step of `period` s from time 0 on.

    T (n, 4, 4): poses at the times `time` (n,) s. Positions are interpolated linearly, rotations along the shortest
    arc. The pose is constant before the first time and after the last one.
    """
    from scipy.spatial.transform import Rotation, Slerp

    steps = np.arange(1, max(1, int(np.ceil(time[-1] / period - 1e-9))) + 1)
    at = np.clip(steps * period, time[0], time[-1])
    position = np.stack([np.interp(at, time, T[:, axis, 3]) for axis in range(3)], axis=1)
    return transform(Slerp(time, Rotation.from_matrix(T[:, :3, :3]))(at).as_matrix(), position)


def circle(period: float) -> TargetSet:
    """Lift the object, then move it once around a level circle; it keeps its orientation."""
    time = np.arange(0.0, LIFT_S + CIRCLE_S + period, period)
    turned = 2.0 * np.pi * _smooth((time - LIFT_S) / CIRCLE_S)
    position = np.stack([CIRCLE_RADIUS * (1.0 - np.cos(turned)), CIRCLE_RADIUS * np.sin(turned),
                         CIRCLE_LIFT * _smooth(time / LIFT_S)], axis=1)
    return _path("circle", time, position, np.zeros((len(time), 3)), period)


def pour(period: float) -> TargetSet:
    """Lift the object, tilt it about the world's x axis as if to pour from it, and set it upright again."""
    time = np.arange(0.0, LIFT_S + 2.0 * TILT_S + POUR_S + period, period)
    tilt = _smooth((time - LIFT_S) / TILT_S) - _smooth((time - LIFT_S - TILT_S - POUR_S) / TILT_S)
    position, turn = np.zeros((2, len(time), 3))
    position[:, 2] = POUR_LIFT * _smooth(time / LIFT_S)
    turn[:, 0] = POUR_ANGLE * tilt
    return _path("pour", time, position, turn, period)


PATHS = {"circle": circle, "pour": pour}
"""The trajectories by the names that `motion.targets` takes."""


def _path(name: str, time: Array, position: Array, turn: Array, period: float) -> TargetSet:
    T = transform(matrix_from_rotation_vector(turn), position)
    return TargetSet(name, sample(time, T, period)[None], relative=True)


def _smooth(s: Array) -> Array:
    """A smooth step from 0 at s = 0 to 1 at s = 1, at rest at both ends and constant beyond."""
    s = np.clip(s, 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))
