"""How and when grasps fail: classes of lost grasps, and the share held over time (docs/report.md).

Every threshold is a constant of this module. The class is a pure function of an `EpisodeRecord`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dgrasp.config.experiment import control_steps
from dgrasp.eval.metrics import fallen_steps, recorded_window
from dgrasp.types import Array, EpisodeRecord

KINDS = ("approach", "lift", "slip", "drop", "broken")
"""The classes of failure, in the order of an episode. An episode in none of these classes was held."""

MEANINGS = {
    "approach": "never gripped: not touched, or tipped or pushed away before the table is taken away",
    "lift": "lost within half a second after the table is taken away",
    "slip": "lost later, after sliding in the hand",
    "drop": "lost later, from a steady grip",
    "broken": "the simulation broke before the object was lost",
}

GRIP_S = 0.15
"""s. The hand must touch the object within this time before the table is removed (or after a start in the grasp)."""
PUSHED_M = 0.05
"""m. The object was pushed away if the approach moved it farther than this along the table."""
TIPPED_RAD = float(np.deg2rad(30.0))
"""rad. The object was tipped if the approach tilted it from the vertical by more than this."""
LIFT_S = 0.5
"""s after the table is removed. A loss up to this time belongs to the lift."""
SLID_M = 0.02
"""m. The object slid if it moved farther than this in the wrist's frame."""
SUDDEN_S = 0.2
"""s. Motion within this time before the loss counts as the loss itself, not as sliding."""


@dataclass(frozen=True)
class Outcome:
    """How an episode ended.

    kind: one of `KINDS`, or "held". step: the last control step with the object in the hand, -1 if there is none; None
    if it was held. lost_s: time of the loss, s after the table was removed, at least 0; None if it was held.
    """

    kind: str
    step: int | None
    lost_s: float | None


def outcome(record: EpisodeRecord, window_s: float) -> Outcome:
    """The outcome of an episode; its kind is "held" exactly if `metrics.success` is true.

    The object is lost at the last step before it lands in which a part of the hand touches it.
    """
    start = record.window_start
    stop = start + recorded_window(record, window_s)
    landed = np.flatnonzero(fallen_steps(record)[start:stop])
    if not landed.size:
        if not record.terminated:
            return Outcome("held", None, None)
        last = len(record.T_WO) - 1
        return Outcome("broken", last, _seconds(record, last))
    touched = np.flatnonzero(_touch(record)[start : start + int(landed[0]) + 1])
    last = start + int(touched[-1]) if touched.size else start - 1
    lost_s = _seconds(record, last)
    if not _gripped(record) or _displaced(record):
        kind = "approach"
    elif lost_s <= LIFT_S:
        kind = "lift"
    else:
        kind = "slip" if _slid_before(record, last) else "drop"
    return Outcome(kind, last, lost_s)


def _seconds(record: EpisodeRecord, step: int) -> float:
    """Time of the state after a step, s after the table was removed, at least 0."""
    return max(0.0, (step - record.window_start + 1) * record.dt)


def _touch(record: EpisodeRecord) -> Array:
    """(T,) bool: a part of the hand touches the object."""
    return np.asarray((np.asarray(record.contacts, dtype=float) > 0.0).any(axis=1))


def _gripped(record: EpisodeRecord) -> bool:
    """Whether the hand touched the object within `GRIP_S` before the table's removal, or after a start in the grasp."""
    steps = max(1, round(GRIP_S / record.dt))
    start = record.window_start
    near = slice(max(0, start - steps), start) if start else slice(0, steps)
    return bool(_touch(record)[near].any())


def _displaced(record: EpisodeRecord) -> bool:
    """Whether the object was tipped or pushed away while the table was there."""
    if record.window_start == 0:
        return False
    first, last = record.T_WO[0], record.T_WO[record.window_start - 1]
    pushed = np.linalg.norm(last[:2, 3] - first[:2, 3])
    # The world's vertical in the object's frame: a rotation about the vertical does not count as tipping.
    tipped = np.arccos(np.clip(first[2, :3] @ last[2, :3], -1.0, 1.0))
    return bool(pushed > PUSHED_M or tipped > TIPPED_RAD)


def _slid_before(record: EpisodeRecord, lost: int) -> bool:
    """Whether the object had slid in the hand by `SUDDEN_S` before the loss."""
    before = lost - round(SUDDEN_S / record.dt)
    reference = max(record.window_start - 1, 0)
    if before <= reference:
        return False
    offset = record.T_WO[:, :3, 3] - record.T_WH[:, :3, 3]
    place = np.einsum("tji,tj->ti", record.T_WH[[reference, before], :3, :3], offset[[reference, before]])
    return bool(np.linalg.norm(place[1] - place[0]) > SLID_M)


def counts(rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Number of rows (of `summary.label_row`) that were held and that failed in each class, including zeros."""
    found = dict.fromkeys(("held", *KINDS), 0)
    for row in rows:
        found[row.get("failure", "held")] += 1
    return found


def held_over_time(rows: Sequence[Mapping[str, Any]], window_s: float, dt: float) -> tuple[Array, dict[str, Array]]:
    """Times (K,), s after the table was removed, and for each object the share (K,) of its labels not yet lost.

    The first time is 0. The last is the end of the window, where the share is the object's success.
    """
    times = np.arange(control_steps(window_s, dt) + 1) * dt
    groups: dict[str, list[float]] = {}
    for row in rows:
        groups.setdefault(row["object"], []).append(row.get("lost_s", np.inf))
    # A loss counts from its own step on. The half step absorbs rounding errors in the times.
    return times, {name: (np.array(lost)[:, None] > times + 0.5 * dt).mean(axis=0) for name, lost in groups.items()}


def report(rows: Sequence[Mapping[str, Any]], window_s: float, dt: float) -> dict[str, Any]:
    """Entries for the JSON: `failures`, counts in total and per object, and `held_over_time`, shares over time."""
    times, shares = held_over_time(rows, window_s, dt)
    lost = {name: [row for row in rows if row["object"] == name] for name in shares}
    sizes = np.array([len(group) for group in lost.values()])
    table = np.array(list(shares.values()))
    return {
        "failures": {"all": counts(rows), "per_object": {name: counts(group) for name, group in lost.items()}},
        "held_over_time": {
            "t_s": np.round(times, 5).tolist(),
            "mean_over_objects": np.round(table.mean(axis=0), 5).tolist(),
            "mean_over_labels": np.round(sizes @ table / sizes.sum(), 5).tolist(),
        },
    }
