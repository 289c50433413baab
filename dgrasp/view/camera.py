"""The camera of a sequence, placed so that it sees both hand and object."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dgrasp.geometry.raster import FIELD_OF_VIEW
from dgrasp.types import Array, EpisodeRecord

PITCH = 0.35
"""rad above the horizontal."""
DISTANCE = 0.7
"""m from the point that the camera turns about, unless a motion needs more."""
_AROUND = 0.12
"""m. Half the size of a hand with an object."""
_WAY = 1.0
"""m. The camera follows a motion per axis this far from where it begins."""


class Viewpoint(NamedTuple):
    """target: the point that the camera turns about, (3,) m, world. yaw: the camera's direction from there, rad about
    z, world. distance: the camera's, m.
    """

    target: Array
    yaw: float
    distance: float

    @property
    def eye(self) -> Array:
        """(3,) m: the camera's position."""
        direction = np.array([np.cos(PITCH) * np.cos(self.yaw), np.cos(PITCH) * np.sin(self.yaw), np.sin(PITCH)])
        return np.asarray(self.target + self.distance * direction)


def viewpoint(record: EpisodeRecord) -> Viewpoint:
    """Where the camera of a sequence is.

    It turns about a point slightly below the line between wrist and object at the time when the table is removed. If
    the object is moved to a target, the camera turns about the middle of the wrist's and the target's way, and sees all
    of it. It looks from the side of the grasp, preferring the palm's side.
    """
    step = min(max(record.window_start - 1, 0), len(record.gc) - 1)
    T_WH, place = np.nan_to_num(record.T_WH[step]), np.nan_to_num(record.T_WO[step, :3, 3])
    target, distance = 0.65 * place + 0.35 * T_WH[:3, 3] - np.array([0.0, 0.0, 0.05]), DISTANCE
    if record.T_WG is not None:
        # An object that is lost may fall out of the picture; the hand and the target stay in it.
        way = np.concatenate([record.T_WH[step:, :3, 3], record.T_WG[step:, :3, 3], place[None]])
        way = np.clip(way[np.isfinite(way).all(axis=1)], T_WH[:3, 3] - _WAY, T_WH[:3, 3] + _WAY)
        low, high = way.min(axis=0), way.max(axis=0)
        target = (low + high) / 2.0
        reach = float(np.linalg.norm(high - low)) / 2.0 + _AROUND
        distance = max(DISTANCE, reach / float(np.sin(FIELD_OF_VIEW / 2.0)))
    palm = -T_WH[:2, 1]
    along = place[:2] - T_WH[:2, 3]
    aside = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 0.05)
    view = 0.8 * palm + aside * (1.0 if aside @ palm >= 0.0 else -1.0)
    yaw = float(np.arctan2(view[1], view[0])) if np.linalg.norm(view) > 1e-6 else -0.7
    return Viewpoint(target, yaw, distance)
