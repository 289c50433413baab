"""Divide labels over workers by measured cost, because a mug can cost five times as much as a can."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dgrasp.types import Array

BALANCE_AFTER = (1, 10, 100)
"""Numbers of collections after which costs are compared; grasps cost more as the policy learns to make them."""
WORTH_MOVING = 0.03
"""Imbalance that a new division must save, as a fraction of the mean load; it rebuilds all worlds."""


def costs(seconds: Array, steps: Array) -> Array:
    """(N,) seconds per control step of each environment; the mean of the others for those that have made no step.

    seconds, steps: (N,) seconds spent and control steps made so far. Without any step, all costs are 1.
    """
    made = steps > 0
    known: Array = np.divide(seconds, steps, out=np.zeros(len(seconds)), where=made)
    return np.where(made, known, known[made].mean() if made.any() else 1.0)


def stretches(cost: Array, workers: int) -> list[slice]:
    """Cut the set into one contiguous stretch per worker, each with nearly the same cost and at least one environment.

    The parts are contiguous because the draw of an epoch (`labels.per_epoch`) takes the same share of any stretch.
    """
    n = len(cost)
    ends = np.cumsum(cost)
    # Cut where the cumulative cost is nearest to each worker's share of the total.
    wanted = ends[-1] * np.arange(1, workers) / workers
    cuts = [int(np.abs(ends - share).argmin()) + 1 for share in wanted.tolist()]
    bounds = [0, *cuts, n]
    for w in range(1, workers):
        bounds[w] = min(max(bounds[w], bounds[w - 1] + 1), n - (workers - w))
    return [slice(a, b) for a, b in pairwise(bounds)]


def imbalance(cost: Array, rows: list[slice]) -> float:
    """How much longer the busiest worker takes than the mean, as a fraction of the mean; 0 is perfect balance.

    cost: (N,) of each environment. rows: the environments of each worker.
    """
    loads = np.array([cost[part].sum() for part in rows])
    return float(loads.max() / loads.mean() - 1.0)


def worthwhile(cost: Array, rows: list[slice]) -> list[slice] | None:
    """A better division of the set than `rows`; None if the gain is not worth making all worlds anew."""
    better = stretches(cost, len(rows))
    return better if imbalance(cost, rows) - imbalance(cost, better) >= WORTH_MOVING else None
