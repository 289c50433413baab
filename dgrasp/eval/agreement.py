"""Compare the outcomes of a published policy here with its outcomes in RaiSim, label by label.

The authors ship `success_idxs.npy` beside a policy. It lists the labels that the policy held in their simulator, as
indices into the train file. For a policy of one object, whose folder's name begins with the object's number, they are
indices among that object's labels.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.labels.load import LabelSet, load_labels
from dgrasp.types import GraspLabel

FILE = "success_idxs.npy"


@dataclass(frozen=True)
class Agreement:
    """Counts of labels held in both simulators, in one and in neither, and the names of those held in only one.

    "here" is this evaluation, "there" is RaiSim.
    """

    both: int
    here_alone: int
    there_alone: int
    neither: int
    labels_here_alone: list[str]
    labels_there_alone: list[str]

    @property
    def share(self) -> float:
        """Share of the labels with the same outcome in both simulators."""
        return (self.both + self.neither) / (self.both + self.here_alone + self.there_alone + self.neither)

    def plain(self) -> dict[str, Any]:
        """Plain values for a JSON file."""
        return {"agreement": self.share, **asdict(self)}

    def lines(self) -> list[str]:
        """Lines for the terminal: the confusion table and the labels that differ."""
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
                lines.append(f"held only {what}: {', '.join(names)}")
        return lines


def find_agreement(policy: Path, chosen: LabelSet, success: Sequence[bool]) -> Agreement | None:
    """The agreement of an evaluation of `policy` with RaiSim, or None if RaiSim's outcomes are not known.

    success: the outcomes of the chosen labels, in their order. RaiSim's outcomes are known for train labels of the
    authors' release if `success_idxs.npy` lies beside the policy. Raises `DataError` if that file is damaged.
    """
    file = policy.with_name(FILE)
    if chosen.released_as != ("dexycb", "train") or not file.is_file():
        return None
    everything = load_labels(chosen.path).labels
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
        raise DataError(f"{file}: not an array of numbers ({error}); remove it, or use the authors' file") from None
    whole = isinstance(places, np.ndarray) and places.ndim == 1 and places.dtype.kind in "iu"
    if not whole or (len(places) and not 0 <= places.min() <= places.max() < len(counted)):
        raise DataError(
            f"{file}: expected whole numbers (n,) from 0 to {len(counted) - 1}, indices of labels in their file; "
            "remove it, or use the authors' file"
        )
    return {_key(counted[place]) for place in places.tolist()}
