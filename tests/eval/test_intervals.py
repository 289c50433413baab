from __future__ import annotations

import numpy as np
import pytest

from dgrasp.eval.intervals import LEVEL, RESAMPLES, intervals, resampled_means


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_of_a_coin() -> None:
    # 100 tosses, 50 heads: the mean varies by sqrt(0.25 / 100) = 0.05, so 95% lie within 0.5 +- 0.098.
    out = intervals({"success": {"a": [0.0, 1.0] * 50}}, rng())
    assert (out["level"], out["resamples"]) == (LEVEL, RESAMPLES) == (0.95, 2000)
    assert out["mean_over_labels"]["success"] == pytest.approx([0.402, 0.598], abs=0.02)
    assert out["per_object"]["a"]["success"] == pytest.approx([0.402, 0.598], abs=0.02)


def test_over_objects_the_objects_are_given_and_their_labels_drawn() -> None:
    # Two very different objects, each with identical labels: resampling labels cannot change the mean.
    values = {"x": {"a": [0.0] * 5, "b": [10.0] * 20}}
    out = intervals(values, rng())
    assert out["mean_over_objects"]["x"] == [5.0, 5.0]
    # Over labels, the shares of the objects vary too: 8 +- 2 * 10 sqrt(0.2 * 0.8 / 25).
    assert out["mean_over_labels"]["x"] == pytest.approx([6.4, 9.6], abs=0.5)


def test_an_interval_shrinks_with_the_root_of_the_number() -> None:
    draws = rng(1).normal(size=1600)
    wide, narrow = (intervals({"x": {"a": draws[:n]}}, rng())["mean_over_labels"]["x"] for n in (100, 1600))
    assert (wide[1] - wide[0]) / (narrow[1] - narrow[0]) == pytest.approx(4.0, rel=0.25)


def test_one_value_has_no_interval() -> None:
    out = intervals({"x": {"a": [1.0], "b": [1.0, 2.0]}, "y": {"a": [3.0]}}, rng())
    assert out["mean_over_objects"] == {} and list(out["mean_over_labels"]) == ["x"]
    assert list(out["per_object"]) == ["b"]


def test_the_same_seed_gives_the_same_intervals() -> None:
    values = {"x": {"a": [1.0, 2.0, 5.0], "b": [0.0, 1.0]}}
    assert intervals(values, rng(3)) == intervals(values, rng(3)) != intervals(values, rng(4))


def test_draws_are_means_of_as_many() -> None:
    means = resampled_means(np.array([0.0, 3.0]), rng())
    assert set(means) == {0.0, 1.5, 3.0} and len(means) == RESAMPLES
