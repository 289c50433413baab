"""Whether a published policy holds here what it held in RaiSim, label by label.

The authors ship `success_idxs.npy` beside a policy: the places of the labels that it held in their simulator,
counted in the train file, or among one object's labels for a policy of that object (its folder begins with the
object's number).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.labels.source import LabelSet, load_labels
from dgrasp.types import GraspLabel

FILE = "success_idxs.npy"


@dataclass(frozen=True)
class Agreement:
    """Counts of labels by where they were held, and the names of those held in one place alone."""

    both: int
    here_alone: int
    there_alone: int
    neither: int
    labels_here_alone: list[str]
    labels_there_alone: list[str]

    @property
    def share(self) -> float:
        """Of the labels on which both say the same."""
        return (self.both + self.neither) / (self.both + self.here_alone + self.there_alone + self.neither)

    def plain(self) -> dict[str, Any]:
        """For a JSON file."""
        return {"agreement": self.share, **asdict(self)}

    def lines(self) -> list[str]:
        """For the terminal: the confusion table, and which labels differ."""
        n = self.both + self.here_alone + self.there_alone + self.neither
        there = self.both + self.there_alone
        lines = [
            f"RaiSim ({FILE}) held {there} of these {n} labels, {there / n:.3f}; "
            f"{self.share:.3f} of the labels have the same outcome here and there",
            f"{'':12}{'RaiSim held':>12}{'dropped':>9}",
            f"{'here held':12}{self.both:>12}{self.here_alone:>9}",
            f"{'dropped':12}{self.there_alone:>12}{self.neither:>9}",
        ]
        for what, names in (("here", self.labels_here_alone), ("in RaiSim", self.labels_there_alone)):
            if names:
                lines.append(f"held {what} alone: {', '.join(names)}")
        return lines


def find_agreement(policy: Path, chosen: LabelSet, success: Sequence[bool]) -> Agreement | None:
    """The agreement of an evaluation of `policy` with RaiSim's, or None where nothing is known of it.

    success: of the chosen labels, in their order. Known are train labels of the authors' release, beside whose
    policy lies `success_idxs.npy`. Raises `DataError` for a damaged one.
    """
    file = policy.with_name(FILE)
    if chosen.published_as != ("dexycb", "train") or not file.is_file():
        return None
    everything = load_labels(chosen.source).labels
    number = re.match(r"(\d{3})_", policy.parent.name)
    counted = [label for label in everything if number is None or label.object_id.startswith(number[0])]
    held = _held(file, counted)
    known = {(label.object_id, label.index) for label in counted}
    pairs = [(label, bool(s)) for label, s in zip(chosen.labels, success, strict=True) if _key(label) in known]
    if not pairs:
        return None
    names: dict[tuple[bool, bool], list[str]] = {(here, there): [] for here in (True, False) for there in (True, False)}
    for label, here in pairs:
        names[here, _key(label) in held].append(f"{label.object_id}[{label.index}]")
    return Agreement(
        len(names[True, True]), len(names[True, False]), len(names[False, True]), len(names[False, False]),
        names[True, False], names[False, True],
    )  # fmt: skip


def _key(label: GraspLabel) -> tuple[str, int]:
    return label.object_id, label.index


def _held(file: Path, counted: Sequence[GraspLabel]) -> set[tuple[str, int]]:
    try:
        places = np.load(file, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise DataError(f"{file}: not an array of numbers ({error}); remove it, or take the authors' file") from None
    whole = isinstance(places, np.ndarray) and places.ndim == 1 and places.dtype.kind in "iu"
    if not whole or (len(places) and not 0 <= places.min() <= places.max() < len(counted)):
        raise DataError(
            f"{file}: expected whole numbers (n,) from 0 to {len(counted) - 1}, places of labels in their file; "
            "remove it, or take the authors' file"
        )
    return {_key(counted[place]) for place in places.tolist()}
