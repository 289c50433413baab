"""Make the labels of one object, and write made labels with what they come from."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.files import licences
from dgrasp.hand.store import FREE_HAND, NamedHand
from dgrasp.labels.formats.native import write_native
from dgrasp.objects.model import ObjectModel
from dgrasp.objects.names import YCB_NAMES
from dgrasp.synthesis.progress import Report
from dgrasp.synthesis.report import figures
from dgrasp.synthesis.synthesiser import Synthesiser
from dgrasp.types import GraspLabel


def make_labels(
    hand: NamedHand, model: ObjectModel, count: int, seed: int, config: Config, report: Report
) -> tuple[list[GraspLabel], dict[str, Any]]:
    """Synthesise `count` labels of one object; returns them and their figures (`report.figures`).

    They depend on the seed and on the object's name. report: called with the share that is done, 1 at the end.
    """
    digest = int.from_bytes(hashlib.sha256(model.name.encode()).digest()[:4], "big")
    made = Synthesiser(hand.model).make(model, count, np.random.default_rng([seed, digest]), config, report=report)
    row = figures(made, hand, model)
    report(1.0)
    return made.labels, row


def write_labels(
    files: Mapping[Path, Sequence[GraspLabel]], hand: NamedHand, per_object: Mapping[str, Mapping[str, Any]],
    free_data: bool, **provenance: Any,
) -> str:
    """Write made labels to their files; returns their licence.

    per_object: the figures of each object. free_data: whether the objects of the 20 are the free set's. provenance:
    further entries on how they were made.
    """
    names = {label.object_id for labels in files.values() for label in labels}
    free = hand.model.id == FREE_HAND and free_data and names <= set(YCB_NAMES.values())
    licence = licences.PROJECT if free else licences.OF_ITS_ORIGINS
    figures = {name: {key: value for key, value in row.items() if key != "cpu_s"} for name, row in per_object.items()}
    for path, labels in files.items():
        write_native(path, list(labels), {"made_by": "dgrasp labels make", **provenance, "per_object": figures},
                     licence, hand.model.layout.names)
    return licence
