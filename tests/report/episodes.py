"""A small evaluation made by hand: four grasps of two objects, two of them lost."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np

from dgrasp.eval.failures import report
from dgrasp.eval.summary import Result, summarise
from dgrasp.report.page import html_text
from dgrasp.types import EpisodeRecord
from dgrasp.view.meshes import DisplayMeshes
from tests.eval.records import DT, label
from tests.eval.test_summary import COST, FREE
from tests.export.sequences import box, episode, meshes

WINDOW = 5 * DT
SUGAR, MUG = "004_sugar_box", "025_mug"


def records(names: tuple[str, str] = (SUGAR, MUG)) -> list[EpisodeRecord]:
    """For each object one episode that is held, and one whose object lands in the sixth step."""
    made = []
    for name in names:
        for index, landed in enumerate((False, True)):
            table = np.arange(8) < 3
            table[6:] = landed
            made.append(episode(label=label(name, index), table_contact=table))
    return made


def evaluated(data: dict[str, Any] = FREE, names: tuple[str, str] = (SUGAR, MUG)) -> Result:
    """The result of `records`."""
    return summarise(records(names), method="gt_pd", engine="pybullet", window_s=WINDOW, seed=1, data=data, cost=COST)


def drawn(names: tuple[str, str] = (SUGAR, MUG)) -> dict[str, DisplayMeshes]:
    """Meshes of both objects."""
    return {names[0]: meshes(), names[1]: dataclasses.replace(meshes(), object=box(0.04, 0.04, 0.05))}


@cache
def page() -> str:
    """The HTML of the report."""
    result = evaluated()
    return html_text(result, records(), drawn(), report(result.per_label, WINDOW, DT))
