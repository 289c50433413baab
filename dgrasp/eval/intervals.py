"""Percentile bootstrap intervals: how much a mean depends on the choice of labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dgrasp.types import Array

LEVEL = 0.95
RESAMPLES = 2000

Interval = list[float]


def intervals(values: Mapping[str, Mapping[str, Sequence[float]]], rng: np.random.Generator) -> dict[str, Any]:
    """Intervals of the means per object, over objects and over labels.

    values: metric -> object -> the values of its labels that have the metric. For means per object and over objects,
    the objects are fixed and labels are resampled within each: an interval shows how the mean varies with other labels
    of the same objects. For means over labels, all labels are resampled together.
    Returns level, resamples, mean_over_objects and mean_over_labels (metric -> [low, high]) and per_object (object ->
    metric -> [low, high]). A mean of one label has no interval, nor has a mean over objects if one has only one label.
    """
    over_objects: dict[str, Interval] = {}
    over_labels: dict[str, Interval] = {}
    per_object: dict[str, dict[str, Interval]] = {}
    for metric, groups in values.items():
        means = []
        for name, group in groups.items():
            if len(group) > 1:
                means.append(resampled_means(np.asarray(group, dtype=float), rng))
                per_object.setdefault(name, {})[metric] = _interval(means[-1])
        if len(means) == len(groups):
            over_objects[metric] = _interval(np.mean(means, axis=0))
        everything = np.concatenate([np.asarray(group, dtype=float) for group in groups.values()])
        if len(everything) > 1:
            over_labels[metric] = _interval(resampled_means(everything, rng))
    return {"level": LEVEL, "resamples": RESAMPLES, "mean_over_objects": over_objects, "mean_over_labels": over_labels,
            "per_object": per_object}


def resampled_means(values: Array, rng: np.random.Generator) -> Array:
    """(RESAMPLES,) means of n values drawn from `values` (n,) with replacement."""
    return np.asarray(values[rng.integers(0, len(values), (RESAMPLES, len(values)))].mean(axis=1))


def _interval(means: Array) -> Interval:
    low, high = np.quantile(means, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
    return [float(low), float(high)]
