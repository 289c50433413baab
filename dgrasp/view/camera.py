"""The camera of a sequence, placed so that it sees both hand and object."""

from __future__ import annotations

import numpy as np

from dgrasp.types import Array, EpisodeRecord

PITCH = 0.35
"""rad above the horizontal."""
DISTANCE = 0.7
"""m from the point that the camera turns about."""


def viewpoint(record: EpisodeRecord) -> tuple[Array, float]:
    """The point that the camera turns about, (3,) m, and the camera's direction from there, rad about z; world frame.

    The point lies slightly below the line between wrist and object at the time when the table is removed. The camera
    looks from the side of the grasp, preferring the palm's side.
    """
    step = min(max(record.window_start - 1, 0), len(record.gc) - 1)
    T_WH, place = np.nan_to_num(record.T_WH[step]), np.nan_to_num(record.T_WO[step, :3, 3])
    target = 0.65 * place + 0.35 * T_WH[:3, 3] - np.array([0.0, 0.0, 0.05])
    palm = -T_WH[:2, 1]
    along = place[:2] - T_WH[:2, 3]
    aside = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 0.05)
    view = 0.8 * palm + aside * (1.0 if aside @ palm >= 0.0 else -1.0)
    yaw = float(np.arctan2(view[1], view[0])) if np.linalg.norm(view) > 1e-6 else -0.7
    return target, yaw


def eye(target: Array, yaw: float) -> Array:
    """(3,) m: the camera's position for a `viewpoint`."""
    direction = np.array([np.cos(PITCH) * np.cos(yaw), np.cos(PITCH) * np.sin(yaw), np.sin(PITCH)])
    return np.asarray(target + DISTANCE * direction)
