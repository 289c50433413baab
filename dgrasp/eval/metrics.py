"""The paper's metrics of one evaluated episode (supplement, "Metrics Details"), as functions of its record.

Where the paper and the code behind its numbers differ, these functions follow the code; docs/deviations.md lists the
differences. The window begins with the first step after the table was taken away and lasts
`control_steps(window_s, dt)` control steps.
"""

from __future__ import annotations

import numpy as np

from dgrasp.config.experiment import control_steps
from dgrasp.errors import DataError
from dgrasp.types import Array, EpisodeRecord

FALLEN_HEIGHT = 0.1
"""m. An object whose origin is at or below this height has fallen past the lowered table."""


def recorded_window(record: EpisodeRecord, window_s: float) -> int:
    """Control steps in the window, fewer if the episode ended early.

    Raises `DataError` for a window shorter than one step, and if the record of an episode that did not end early is
    shorter than the window.
    """
    steps = control_steps(window_s, record.dt)
    if steps < 1:
        raise DataError(f"{record.label.name}: a window of {window_s:g} s has no control step of {record.dt:g} s; "
                        "expected at least one step; choose a longer window")
    available = len(record.T_WO) - record.window_start
    if record.terminated:
        return max(0, min(steps, available))
    if available < steps:
        raise DataError(f"{record.label.name}: {max(available, 0)} control steps recorded after the table was taken "
                        f"away; a window of {window_s:g} s needs {steps}; run longer episodes or choose a shorter "
                        "window")
    return steps


def success(record: EpisodeRecord, window_s: float) -> bool:
    """Whether the object was held for the whole window.

    In each step of the window the object does not touch the lowered table and its origin is above z = 0.1 m, and the
    episode did not end early.
    """
    stop = record.window_start + recorded_window(record, window_s)
    if record.terminated:
        return False
    return not fallen_steps(record)[record.window_start : stop].any()


def sim_dist_mm_per_step(record: EpisodeRecord, window_s: float) -> float | None:
    """Mean displacement of the object in the world per control step, mm: the unit of the paper's tables.

    Mean of |x_t - x_(t-1)| over the window's steps, up to and including the step in which the object falls onto the
    lowered table (or past it), if there is one. None if the episode ended before the window began.
    """
    return _mean_step_mm(record, window_s, record.T_WO[:, :3, 3])


def sim_dist_mm_per_s(record: EpisodeRecord, window_s: float) -> float | None:
    """`sim_dist_mm_per_step` over the control period: mm per second, the unit of the paper's text."""
    per_step = sim_dist_mm_per_step(record, window_s)
    return None if per_step is None else per_step / record.dt


def sim_dist_wrist_mm_per_step(record: EpisodeRecord, window_s: float) -> float | None:
    """`sim_dist_mm_per_step` in the wrist frame: the displacement between object and wrist of the paper's text."""
    offset = record.T_WO[:, :3, 3] - record.T_WH[:, :3, 3]
    return _mean_step_mm(record, window_s, np.einsum("tji,tj->ti", record.T_WH[:, :3, :3], offset))


def contact_ratio(record: EpisodeRecord) -> float | None:
    """Achieved goal contacts / goal contacts, mean over the whole sequence; None for a label without goal contacts."""
    goal = np.asarray(record.label.goal_contacts, dtype=bool)
    achieved = np.asarray(record.contacts, dtype=float)[:, goal] > 0.0
    return float(achieved.mean()) if achieved.size else None


def grasp_pose(record: EpisodeRecord) -> tuple[Array, Array, Array] | None:
    """T_WH (4, 4), finger angles (J,) and T_WO (4, 4) of the finished grasp; None if the episode ended before it.

    The poses are those of the last step of the grasping phase. A baseline that starts in the label's pose has no such
    phase: its grasp is the label itself, before any simulation, as in the paper.
    """
    if record.window_start == 0:
        label = record.label
        return label.T_WH, label.hand_pose, label.T_WO
    step = record.window_start - 1
    if step >= len(record.gc):
        return None
    return record.T_WH[step], record.gc[step, 6:], record.T_WO[step]


def label_distance_mm(record: EpisodeRecord) -> float | None:
    """Mean distance between the key points of the finished grasp and of the label, in the object's frame, mm.

    None for a baseline that starts in the label's pose, and if the episode ended before its grasp was finished.
    """
    step = record.window_start - 1
    if not 0 <= step < len(record.gc):
        return None
    label = record.label
    here, there = _in_frame(record.T_WO[step], record.joints_W[step]), _in_frame(label.T_WO, label.joints_W)
    distance = 1000.0 * float(np.linalg.norm(here - there, axis=1).mean())
    return distance if np.isfinite(distance) else None


def label_angles_deg(record: EpisodeRecord) -> float | None:
    """Mean absolute difference between the finger angles of the finished grasp and of the label, degrees.

    None in the same cases as for `label_distance_mm`.
    """
    step = record.window_start - 1
    if not 0 <= step < len(record.gc):
        return None
    return float(np.degrees(np.abs(record.gc[step, 6:] - record.label.hand_pose).mean()))


def position_errors_m(record: EpisodeRecord) -> Array:
    """(T',) m: distance between the object and its target after each step of the window (supplement, e_mpe).

    This is the norm, as in the authors' code; the paper's formula has its square, but the size of the paper's numbers
    agrees with the norm.
    """
    T_WG = _targets(record)
    offset = record.T_WO[record.window_start :, :3, 3] - T_WG[record.window_start :, :3, 3]
    return np.asarray(np.linalg.norm(offset, axis=1))


def geodesic_errors_rad(record: EpisodeRecord) -> Array:
    """(T',) rad: angle between the object's and its target's rotation after each step of the window.

    Equal to acos((trace(R_o R_g^T) - 1) / 2) of the supplement, computed by a formula that is accurate at small angles.
    """
    T_WG = _targets(record)[record.window_start :]
    R = np.matmul(record.T_WO[record.window_start :, :3, :3], np.swapaxes(T_WG[:, :3, :3], 1, 2))
    sine = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    return np.asarray(np.arctan2(np.linalg.norm(sine, axis=1), np.trace(R, axis1=1, axis2=2) - 1.0))


def mpe_m(record: EpisodeRecord) -> float | None:
    """The position error at the end of the episode, m; None if it ended before its motion began."""
    return _last(position_errors_m(record))


def geodesic_rad(record: EpisodeRecord) -> float | None:
    """The angular error at the end of the episode, rad; None if it ended before its motion began."""
    return _last(geodesic_errors_rad(record))


def _in_frame(T_WO: Array, points_W: Array) -> Array:
    """World points (K, 3) expressed in the frame T_WO (4, 4)."""
    local: Array = (points_W - T_WO[:3, 3]) @ T_WO[:3, :3]
    return local


def _targets(record: EpisodeRecord) -> Array:
    """(T, 4, 4) the object's target pose after each step."""
    if record.T_WG is None:
        raise DataError(f"{record.label.name}: the episode has no target pose of the object; expected T_WG")
    return record.T_WG


def _last(errors: Array) -> float | None:
    finite = errors[np.isfinite(errors)]
    return float(finite[-1]) if finite.size else None


def has_fallen(table_contact: Array, height_W: Array) -> Array:
    """bool: whether the object touches the table or is at `FALLEN_HEIGHT` or below; both arguments have its shape.

    table_contact: bool, or 0 and 1. height_W: z of the object's origin, m; a NaN height counts as fallen.
    """
    return np.asarray(table_contact, dtype=bool) | ~(height_W > FALLEN_HEIGHT)


def fallen_steps(record: EpisodeRecord) -> Array:
    """(T,) bool: `has_fallen` after each step of an episode."""
    return has_fallen(record.table_contact, record.T_WO[:, 2, 3])


def _mean_step_mm(record: EpisodeRecord, window_s: float, position: Array) -> float | None:
    # The first difference needs the state before the window, which a record that begins with the window does not have.
    start = max(record.window_start, 1)
    stop = record.window_start + recorded_window(record, window_s)
    landed = np.flatnonzero(fallen_steps(record)[start:stop])
    if landed.size:
        stop = start + int(landed[0]) + 1
    if stop <= start:
        return None
    steps = np.linalg.norm(np.diff(position[start - 1 : stop], axis=0), axis=1)
    if record.terminated:
        # The state that ended the episode may contain NaN or infinity.
        steps = steps[np.isfinite(steps)]
    if not np.isfinite(steps).all():
        raise DataError(f"{record.label.name}: NaN or infinity in the recorded states of an episode that did not end; "
                        "expected finite states; rerun this label with another timestep")
    return float(steps.mean() * 1000.0) if steps.size else None
