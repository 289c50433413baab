"""Measure what may be wrong with labels: limits, penetration, distance, frames, table, weight, duplicates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.intersection import Body, join, near, overlap
from dgrasp.hand.layout import N_WRIST
from dgrasp.hand.model import HandModel
from dgrasp.hand.spheres import CONTACT_DISTANCE
from dgrasp.hand.surface import HandSurface
from dgrasp.labels.quality.weight import Carrying
from dgrasp.scene.scene import TABLE_SIZE, TABLE_TOP, TABLE_XY
from dgrasp.types import Array, GraspLabel

LIMIT_DEG = 15.0
"""Degrees by which a joint may lie beyond its limit before it counts as a problem."""
DEEP_CM3 = 10.0
"""cm^3. More penetration is a problem (the recorded labels of the paper have 4.6 on average)."""
OFF_MM = 2.0
"""mm by which a label's key points may differ from those of the hand in the label's pose."""
TABLE_MM = 10.0
"""mm by which the object may lie under or over the table's top."""
SUNK_MM = 20.0
"""mm by which the hand may be under the table, with the object at its start: some grasp an object already lifted."""
SAME_M, SAME_RAD = 0.001, 0.0175
"""Labels whose wrists (in the object's frame) and angles agree to this much are duplicates."""
_SEARCH = 0.5
"""m. Larger distances are not distinguished."""


@dataclass(frozen=True, eq=False)
class Finding:
    """The figures of one label.

    beyond_limits: number of joint angles outside the hand's limits; limit_excess_deg: the largest excess.
    penetration_cm3: None if the hand's surface cannot be closed. distance_mm: between hand and object, 0 if they meet.
    contacts: number of goal contacts. off_mm: largest distance of the key points from the hand's. table_mm: height of
    the object's lowest point over the table at the start (at the grasp if there is no start), None for labels without a
    table; under_mm: how far it is below the table at the grasp. sunk_mm: how far the hand's lowest key point would be
    below the table if it grasped the object at its start. carries: whether the hand's contacts can balance the object's
    weight (`Carrying`). duplicate_of: an earlier label that this one repeats. beside: whether the object starts beside
    the table, not over it.
    """

    label: GraspLabel
    beyond_limits: int
    limit_excess_deg: float
    penetration_cm3: float | None
    distance_mm: float
    contacts: int
    off_mm: float
    table_mm: float | None
    under_mm: float
    sunk_mm: float = 0.0
    carries: bool = True
    duplicate_of: str | None = None
    beside: bool = False

    @property
    def problems(self) -> list[str]:
        """The label's problems in words; empty for a sound label."""
        found = []
        if self.off_mm > OFF_MM:
            found.append(f"key points {self.off_mm:.1f} mm from the hand's")
        if self.penetration_cm3 is None:
            found.append("penetration not measured")
        elif self.penetration_cm3 > DEEP_CM3:
            found.append(f"penetration {self.penetration_cm3:.1f} cm3")
        if self.distance_mm > 1000.0 * CONTACT_DISTANCE:
            found.append(f"hand {self.distance_mm:.0f} mm from the object")
        if self.limit_excess_deg > LIMIT_DEG:
            found.append(f"joint {self.limit_excess_deg:.0f} degrees beyond its limit")
        if self.contacts == 0:
            found.append("no goal contacts")
        if self.beside:
            found.append("object beside the table")
        if self.table_mm is not None and abs(self.table_mm) > TABLE_MM:
            found.append(f"object {abs(self.table_mm):.0f} mm {'over' if self.table_mm > 0 else 'under'} the table")
        elif self.under_mm > TABLE_MM:
            found.append(f"object {self.under_mm:.0f} mm under the table at the grasp")
        if self.sunk_mm > SUNK_MM:
            found.append(f"hand {self.sunk_mm:.0f} mm under the table, at the object's start")
        if not self.carries:
            found.append("what it touches cannot carry the weight")
        if self.duplicate_of is not None:
            found.append(f"the same as {self.duplicate_of}")
        return found

    @property
    def badness(self) -> float:
        """The sum of all figures, each divided by the size at which it is a problem; higher is worse."""
        table = max(abs(self.table_mm or 0.0), self.under_mm)
        return (self.off_mm / OFF_MM + (self.penetration_cm3 or 0.0) / DEEP_CM3
                + self.distance_mm / (1000.0 * CONTACT_DISTANCE) + self.limit_excess_deg / LIMIT_DEG
                + table / TABLE_MM + self.sunk_mm / SUNK_MM + (not self.carries) + (self.contacts == 0)
                + self.beside + (self.duplicate_of is not None) + (self.penetration_cm3 is None))


def measure_labels(
    labels: Sequence[GraspLabel], hand: HandModel, surface: HandSurface, objects: Mapping[str, Body],
    progress: Callable[[list[GraspLabel]], Iterable[GraspLabel]] = iter, carrying: Carrying | None = None,
    simulated: Mapping[str, Array] | None = None,
) -> list[Finding]:
    """The findings of all labels, in their order.

    objects: each object's surface in its frame. simulated: the vertices of each object's collision shapes, which stand
    on the table, in its frame; None if they are those of the surface. Without `carrying`, all labels are taken to carry
    their objects. So are labels without a table, because the direction of gravity is unknown for them.
    """
    same = duplicates(labels)
    return [
        _measure(label, hand, surface, objects[label.object_id], carrying, same.get(i),
                 objects[label.object_id].vertices if simulated is None else simulated[label.object_id])
        for i, label in enumerate(progress(list(labels)))
    ]  # fmt: skip


def _measure(
    label: GraspLabel, hand: HandModel, surface: HandSurface, target: Body, carrying: Carrying | None, same: str | None,
    standing: Array,
) -> Finding:
    joints = hand.keypoints_at(label.T_WH[None], label.hand_pose[None])[0]
    limits = hand.limits[N_WRIST:]
    excess = np.maximum(limits[:, 0] - label.hand_pose, label.hand_pose - limits[:, 1])
    excess = np.maximum(excess, np.abs(label.hand_pose - hand.ties.coordinates(label.hand_pose)))
    penetration, distance = _contact(label, surface, target)
    rest = label.T_WO if label.start is None else label.start.T_WO
    heights = [1000.0 * float((standing @ T[2, :3]).min() + T[2, 3] - TABLE_TOP) for T in (rest, label.T_WO)]
    return Finding(
        label=label, beyond_limits=int((excess > 1e-6).sum()),
        limit_excess_deg=float(np.rad2deg(max(excess.max(), 0.0))), penetration_cm3=penetration,
        distance_mm=distance, contacts=int(label.goal_contacts.sum()),
        off_mm=1000.0 * float(np.linalg.norm(joints - label.joints_W, axis=1).max()),
        table_mm=heights[0] if label.on_table else None, under_mm=max(0.0, -heights[1]) if label.on_table else 0.0,
        sunk_mm=_sunk(label) if label.on_table else 0.0,
        carries=carrying is None or not label.on_table or carrying.carries(label), duplicate_of=same,
        beside=label.on_table and not _over_table(standing @ rest[:2, :3].T + rest[:2, 3]),
    )  # fmt: skip


def _over_table(points: Array) -> bool:
    """Whether the middle of an object's outline (V, 2), seen from above, lies over the table."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    return bool((np.abs(middle - TABLE_XY) <= np.array(TABLE_SIZE[:2]) / 2.0).all())


def _sunk(label: GraspLabel) -> float:
    """mm from the table's top down to the lowest key point of the hand, if it grasps the object at its start."""
    if label.start is None:
        return 0.0
    moved = label.start.T_WO @ np.linalg.inv(label.T_WO)
    heights = label.joints_W @ moved[2, :3] + moved[2, 3] - TABLE_TOP
    return max(0.0, -1000.0 * float(heights.min()))


def _contact(label: GraspLabel, surface: HandSurface, target: Body) -> tuple[float | None, float]:
    """Penetration, cm^3, and distance, mm."""
    pieces = surface.pieces(np.linalg.inv(label.T_WO) @ label.T_WH, label.hand_pose)
    touching = near(pieces, target)
    if touching:
        try:
            volume = 1e6 * overlap(join(touching), target).volume
        except DataError:
            return None, _distance(pieces, target)
        if volume > 1e-6:
            return volume, 0.0
    return 0.0, _distance(pieces, target)


def _distance(pieces: Sequence[Body], target: Body) -> float:
    """mm between the surfaces."""
    if target.solid is not None and all(piece.solid is not None for piece in pieces):
        return 1000.0 * min(float(piece.solid.min_gap(target.solid, _SEARCH)) for piece in pieces)
    from scipy.spatial import cKDTree

    tree = cKDTree(target.vertices)
    return 1000.0 * min(float(tree.query(piece.vertices)[0].min()) for piece in pieces)


def duplicates(labels: Sequence[GraspLabel]) -> dict[int, str]:
    """The labels that repeat an earlier one of the same object: index -> the earlier label's name."""
    from scipy.spatial import cKDTree

    found: dict[int, str] = {}
    for name in dict.fromkeys(label.object_id for label in labels):
        own = [i for i, label in enumerate(labels) if label.object_id == name]
        rows = np.stack([_features(labels[i]) for i in own])
        for a, b in sorted(cKDTree(rows).query_pairs(1.0, p=np.inf)):
            found.setdefault(own[b], labels[own[a]].name)
    return found


def _features(label: GraspLabel) -> Array:
    """(12 + J,): wrist in the object's frame and angles, in units of `SAME_M` and `SAME_RAD`."""
    T_OH = np.linalg.inv(label.T_WO) @ label.T_WH
    return np.concatenate([T_OH[:3, 3] / SAME_M, T_OH[:3, :3].ravel() / SAME_RAD, label.hand_pose / SAME_RAD])
