"""The numbers of the paper's tables, with this project's names of methods and metrics."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from dgrasp.labels.sources import SOURCES

_COLUMNS = {"gt_pd": "pd", "gt_ik": "ik", "policy": "ours"}
_MISPRINTED = {("grasptta", "gt_ik")}
"""Misprinted columns: the paper's +IK columns here repeat the +PD columns of the other split."""

Column = dict[str, dict[str, float]]


@cache
def paper_tables() -> dict[str, Any]:
    """All tables as printed: experiment, split, object (or "average"), method. Callers must not modify them."""
    text = (Path(__file__).parent / "paper_tables.yaml").read_text(encoding="utf-8")
    tables: dict[str, Any] = yaml.safe_load(text)
    return tables


def paper_column(labels_source: str, split: str, method: str) -> Column | None:
    """One method's column: object, or "average" as printed -> metric, by this project's name -> value.

    labels_source: the name of a label source. split: "train" or "test". method: "gt_pd", "gt_ik" or "policy".
    Metrics: success, sim_dist_mm_per_step (the printed mean), interpenetration_cm3, and the same number as
    interpenetration_shell_cm3, because the paper measured the shell (docs/metrics.md). None if the paper has no such
    column or the column is misprinted.
    """
    source = SOURCES.get(labels_source)
    if source is None or not source.comparable_with_paper:
        return None
    if method not in _COLUMNS or (labels_source, method) in _MISPRINTED:
        return None
    table = paper_tables().get(labels_source, {}).get(split, {})
    column = {
        name: _metrics(methods[_COLUMNS[method]]) for name, methods in table.items() if _COLUMNS[method] in methods
    }
    return column or None


MOTION_OBJECTS = ("002_master_chef_can", "004_sugar_box", "007_tuna_fish_can", "019_pitcher_base",
                  "052_extra_large_clamp", "061_foam_brick")
"""The paper's objects of motion synthesis (supplement, "Experimental Details")."""
_MOTION = {"policy": "ours", "static_grasp": "static_grasp", "flat_rl": "flat_rl", "learned_motion": "learned_policy"}


def motion_column(method: str, objects: Collection[str], targets: str) -> Column | None:
    """One row of the motion table, as metric -> {"average": value}. The paper has no numbers per object.

    method: "policy", "static_grasp", "flat_rl" or "learned_motion". Metrics: mpe_m, geodesic_rad. None for other
    methods, for objects other than the paper's six, and for targets other than "easy", the authors'.
    """
    if method not in _MOTION or set(objects) != set(MOTION_OBJECTS) or targets != "easy":
        return None
    entry = paper_tables()["motion"][_MOTION[method]]
    return {"mpe_m": {"average": float(entry["mpe"])}, "geodesic_rad": {"average": float(entry["geodesic_rad"])}}


def _metrics(entry: dict[str, Any]) -> dict[str, float]:
    return {
        "success": float(entry["success"]),
        "sim_dist_mm_per_step": float(entry["sim_dist"][0]),
        "interpenetration_cm3": float(entry["interpenetration_cm3"]),
        "interpenetration_shell_cm3": float(entry["interpenetration_cm3"]),
    }
