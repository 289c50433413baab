"""Evaluated episodes: their phases, their records, and how a fall and an explosion appear in them."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.config.experiment import Config, make_config
from dgrasp.eval import evaluator
from dgrasp.eval.evaluator import UNSTABLE, evaluate, evaluate_labels
from dgrasp.eval.metrics import success
from dgrasp.methods import PdBaseline
from dgrasp.pool import make_pool
from dgrasp.pool.serial import SerialPool
from dgrasp.types import Array
from raisim_like import registry
from raisim_like.engines import default_engine
from tests.scenes import make_spec


class Still:
    """A method with zero actions: the wrist is guided to its goal, and the fingers stay open."""

    name, mode = "still", "test"

    def act(self, observation: Array) -> Array:
        return np.zeros((len(observation), 51), np.float32)


@pytest.fixture(scope="module")
def pool():
    made = SerialPool(make_spec(2, ["env.grasp_steps=8", "env.episode_steps=40"]))
    yield made
    made.close()


def windowed(pool: SerialPool, window_s: float) -> Config:
    """The pool's config with another window."""
    return make_config({**pool.env.config.model_dump(), "eval": {"window_s": window_s}})


def test_the_table_goes_after_the_grasp_and_an_open_hand_drops_the_object(pool):
    config = pool.env.config
    said = []
    records, cost = evaluate(pool, Still(), windowed(pool, 0.7), lambda done, total: said.append((done, total)))
    steps = 8 + round(0.7 / config.control_period)
    assert said[-1] == (steps, steps) and cost["control_steps"] == 2 * steps and 0 < cost["physics_share"] < 1
    for record in records:
        assert record.window_start == 8 and len(record.gc) == steps and record.terminated == ""
        height = record.T_WO[:, 2, 3]
        assert np.ptp(height[:8]) < 2e-3, "it stands on the table while there is one"
        assert height[-1] < height[7] - 0.2 and record.table_contact[8:].any()
        assert not success(record, 0.7)
        assert np.allclose(record.T_WH[:, :3, 3], record.joints_W[:, 0])


def test_the_pd_baseline_starts_in_the_labels_pose_without_a_table(pool):
    records, _ = evaluate(pool, PdBaseline(), windowed(pool, 0.1))
    label = pool.labels[1]
    assert records[1].window_start == 0
    # The wrist's controller compensates for the object's weight, so the wrist rises until it carries the object.
    rise = records[1].T_WH[0, :3, 3] - label.T_WH[:3, 3]
    assert np.abs(rise[:2]).max() < 2e-3
    assert 0.0 < rise[2] < 10.0 * pool.env.s.object_mass[1] / 500.0
    assert np.allclose(records[1].gc[0, 6:], label.hand_pose, atol=2e-2)
    # One control step of free fall from rest: g t^2 / 2 = 4.1 mm.
    assert label.T_WO[2, 3] - records[1].T_WO[0, 2, 3] == pytest.approx(4.1e-3, abs=5e-4)


def test_an_explosion_cuts_the_record_and_is_a_failure(pool, monkeypatch):
    batch = pool.env.worlds.batch
    advance, calls = batch.advance, []

    def broken(rows, targets, substeps):
        advance(rows, targets, substeps)
        calls.append(1)
        if len(calls) == 5:
            batch.state.gc[0, 20] = np.nan

    monkeypatch.setattr(batch, "advance", broken)
    records, _ = evaluate(pool, Still(), windowed(pool, 0.1))
    assert records[0].terminated == UNSTABLE and len(records[0].gc) == 4 and np.isfinite(records[0].gc).all()
    assert not success(records[0], 0.1) and records[1].terminated == ""
    (event,) = pool.drain_events()
    assert "env 0" in event


def test_a_test_of_many_labels_goes_through_them_in_parts_with_the_same_records(monkeypatch):
    spec = make_spec(5, ["env.grasp_steps=3", "eval.window_s=0.1", "pool.kind=serial"])
    whole, cost, _ = evaluate_labels(spec, Still())
    made, said = [], []
    monkeypatch.setattr(registry, "AT_ONCE", {default_engine(): 2})
    monkeypatch.setattr(evaluator, "make_pool", lambda part: made.append(len(part.labels)) or make_pool(part))
    records, cost_of_parts, _ = evaluate_labels(spec, Still(), progress=lambda *now: said.append(now))
    assert made == [1, 2, 2] and said == [(step, 18) for step in range(1, 19)]
    assert cost_of_parts["control_steps"] == cost["control_steps"] == 5 * 6
    assert [record.label for record in records] == [record.label for record in whole] == list(spec.labels)
    for one, other in zip(records, whole, strict=True):
        assert np.array_equal(one.gc, other.gc) and np.array_equal(one.T_WO, other.T_WO)
        assert np.array_equal(one.reward, other.reward)
