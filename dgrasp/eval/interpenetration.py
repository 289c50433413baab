"""Volume of the hand inside the object in the finished grasp (supplement, "Metrics Details")."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.eval.metrics import grasp_pose
from dgrasp.geometry.intersection import join, near, overlap
from dgrasp.geometry.shell import cubes_inside, surface_cubes
from dgrasp.hand.surface import SKIN, HandSurface
from dgrasp.objects.body import ObjectBody
from dgrasp.types import Array, EpisodeRecord

CM3 = 1e6
"""cm^3 per m^3."""


@dataclass
class Interpenetration:
    """Measures episodes and counts how the measurements were made.

    preparation_s, seconds: time spent, s. measured: episodes. by_points: of these, measured by points alone.
    doubtful: measurements in which booleans and points disagree. failed: episodes that could not be measured.
    """

    surface: HandSurface
    objects: Mapping[str, ObjectBody]
    preparation_s: float = 0.0
    seconds: float = 0.0
    measured: int = 0
    by_points: int = 0
    doubtful: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        started = time.perf_counter()
        self._cubes: dict[str, Array] = {name: surface_cubes(entry.body) for name, entry in self.objects.items()}
        self.preparation_s += time.perf_counter() - started

    def measure(self, record: EpisodeRecord) -> dict[str, float]:
        """`interpenetration_cm3` and `interpenetration_shell_cm3` of an episode; {} if it ended before the grasp.

        The first is the volume inside both meshes. The second counts 5 mm cubes of the object's surface, as the paper's
        numbers do. Both are measured in the state of `grasp_pose`.
        """
        pose = grasp_pose(record)
        if pose is None:
            return {}
        started = time.perf_counter()
        T_WH, hand_pose, T_WO = pose
        T_OH = np.linalg.inv(T_WO) @ T_WH
        target = self.objects[record.label.object_id]
        try:
            pieces = near(self.surface.pieces(T_OH, hand_pose), target.body)
        except DataError as error:
            self.failed.append(f"{record.label.name}: {error}")
            return {}
        values = {"interpenetration_cm3": 0.0, "interpenetration_shell_cm3": 0.0}
        if pieces:
            hand = join(pieces)
            shared = overlap(hand, target.body)
            if shared.disagrees:
                self.doubtful.append(f"{record.label.name}: {CM3 * shared.volume:.2f} cm3 by booleans, "
                                     f"{CM3 * shared.by_points:.2f} by points")
            self.by_points += not shared.exact
            values = {"interpenetration_cm3": CM3 * shared.volume,
                      "interpenetration_shell_cm3": CM3 * cubes_inside(self._cubes[record.label.object_id], hand)}
        self.measured += 1
        self.seconds += time.perf_counter() - started
        return values

    def report(self) -> dict[str, Any]:
        """How the numbers were measured, as plain values; see docs/metrics.md."""
        bodies = self.objects.values()
        detailed = sum(b.detailed for b in bodies)
        kinds = {"detailed" if b.detailed else "own" if b.own else "collision shapes" for b in bodies}
        return {
            "hand_mesh": self.surface.kind,
            "object_mesh": kinds.pop() if len(kinds) == 1 else "mixed",
            "as_in_the_paper": self.surface.kind == SKIN and detailed == len(bodies),
            "holes_capped_in_objects": sum(b.body.holes for b in bodies),
            "measured": self.measured,
            "by_points_alone": self.by_points,
            "doubtful": self.doubtful,
            "failed": self.failed,
            "preparation_s": self.preparation_s,
            "seconds_per_episode": self.seconds / max(self.measured, 1),
        }
