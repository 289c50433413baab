"""Where an episode begins, also for labels that are one static grasp without an approach."""

from __future__ import annotations

import numpy as np

from dgrasp.objects.model import ObjectModel
from dgrasp.types import GraspLabel, StartPose

APPROACH_DISTANCE = 0.10
"""m that the wrist is drawn back from its goal, away from the object (supplement B.5: "a predefined distance")."""


def start_pose(label: GraspLabel, model: ObjectModel) -> StartPose:
    """The label's own start, or the wrist drawn back from the object with a flat hand."""
    if label.start is not None:
        return label.start
    away = label.T_WH[:3, 3] - label.T_WO[:3, 3]
    distance = float(np.linalg.norm(away))
    direction = away / distance if distance > 1e-6 else np.array([0.0, 0.0, 1.0])
    T_WH = label.T_WH.copy()
    T_WH[:3, 3] += APPROACH_DISTANCE * direction
    return StartPose(T_WH, label.T_WO, np.zeros(45))
