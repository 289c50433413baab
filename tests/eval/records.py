"""Episode records made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from dgrasp.types import Array, EpisodeRecord, GraspLabel

DT = 0.02886
"""The control period of the paper's code: 13 substeps of 0.00222 s."""


def label(name: str = "004_sugar_box", index: int = 0, goal: Any = (0, 3)) -> GraspLabel:
    """A label with goal contacts at the parts `goal`."""
    contacts = np.zeros(16, dtype=bool)
    contacts[list(goal)] = True
    return GraspLabel(
        object_id=name, hand_pose=np.zeros(45), T_WH=np.eye(4), T_WO=np.eye(4), joints_W=np.zeros((21, 3)),
        goal_contacts=contacts, start=None, hand="free", source="test", index=index,
    )


def record(
    position: Any, *, window_start: int = 0, table: Any = None, contacts: Any = None, T_WH: Any = None,
    terminated: str = "", of: GraspLabel | None = None,
) -> EpisodeRecord:
    """An episode whose object is at `position` (T, 3) after each control step; the hand stays at the origin."""
    position = np.asarray(position, dtype=float)
    n = len(position)
    T_WO: Array = np.tile(np.eye(4), (n, 1, 1))
    T_WO[:, :3, 3] = position
    return EpisodeRecord(
        label=of or label(), gc=np.zeros((n, 51)), T_WH=np.tile(np.eye(4), (n, 1, 1)) if T_WH is None else T_WH,
        joints_W=np.zeros((n, 21, 3)), T_WO=T_WO, contacts=np.zeros((n, 16)) if contacts is None else contacts,
        contact_impulse=np.zeros((n, 16)), reward=np.zeros(n),
        table_contact=np.zeros(n, dtype=bool) if table is None else np.asarray(table),
        window_start=window_start, dt=DT, terminated=terminated,
    )


def standing(pose: Any, steps: int) -> Array:
    """(T, 4, 4): a constant pose (4, 4) for the given number of steps."""
    return np.tile(np.asarray(pose, dtype=float), (steps, 1, 1))


def at(height: Any) -> Array:
    """Positions (T, 3) at the heights `height`."""
    height = np.asarray(height, dtype=float)
    return np.stack([np.zeros_like(height), np.zeros_like(height), height], axis=1)
