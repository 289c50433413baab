"""Labels divided over workers by measured cost."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.pool.balance import costs, imbalance, stretches
from dgrasp.pool.process import ProcessPool
from dgrasp.rl.collect import Actor
from tests.scenes import make_spec


def test_costs_are_seconds_per_step_and_the_mean_where_nothing_is_known() -> None:
    assert costs(np.array([2.0, 0.0, 3.0]), np.array([4, 0, 2])).tolist() == [0.5, 1.0, 1.5]
    assert costs(np.zeros(3), np.zeros(3, int)).tolist() == [1.0, 1.0, 1.0]


def test_each_stretch_costs_the_same() -> None:
    # Four mugs of cost 5 and ten cans of cost 1 are 30: one half is three mugs, the other a mug and the cans.
    cost = np.array([5.0] * 4 + [1.0] * 10)
    assert stretches(cost, 2) == [slice(0, 3), slice(3, 14)]
    assert imbalance(cost, stretches(cost, 2)) == 0.0
    # Alternating environments put both mugs on one worker: 10 against 2, with a mean of 6.
    assert imbalance(np.array([5.0, 1.0, 5.0, 1.0]), [slice(0, 4, 2), slice(1, 4, 2)]) == pytest.approx(10 / 6 - 1)


@pytest.mark.parametrize("workers", [1, 3, 7])
def test_every_worker_has_one_and_every_environment_a_worker(workers: int) -> None:
    for cost in (np.array([100.0, 1, 1, 1, 1, 1, 1]), np.array([1.0, 1, 1, 1, 1, 1, 100]), np.ones(7)):
        rows = stretches(cost, workers)
        assert np.concatenate([np.arange(7)[part] for part in rows]).tolist() == list(range(7))
        assert all(part.stop > part.start for part in rows)


def test_a_division_by_cost_changes_no_bit(monkeypatch: pytest.MonkeyPatch, engine: str) -> None:
    rng = np.random.default_rng(0)
    layer = (rng.normal(size=(51, 279)).astype(np.float32) / 50, rng.normal(size=51).astype(np.float32))
    actor = Actor((layer,), np.full(51, 0.5, np.float32), 1)
    pool = ProcessPool(make_spec(3, ["env.episode_steps=24", "env.grasp_steps=20", f"engine={engine}"]), 2)
    try:
        before = {k: v.copy() for k, v in vars(pool.collect(actor, 2, 24, lambda n: None)).items()}
        # Pretend that the first label has cost as much as the other two together.
        told = pool._listen()
        pool._spent[:] = [[2e6, 1e6, 1e6], [100, 100, 100]]
        monkeypatch.setattr(pool, "_listen", lambda: told)
        after = pool.collect(actor, 2, 24, lambda n: None)
        assert pool._rows == [slice(0, 1), slice(1, 3)]
        for name, array in vars(after).items():
            assert np.array_equal(array, before[name]), name
        monkeypatch.undo()
        assert pool.timing()["physics_s"] > 0.0
    finally:
        pool.close()
