"""Pools that run environments. `serial` is the reference; tests check that the others equal it to the bit.

`thread` is the serial pool with worlds that step side by side.
"""

from __future__ import annotations

from dgrasp.config.experiment import Config
from dgrasp.errors import ConfigError
from dgrasp.pool.base import Pool, PoolError, PoolSpec, WorkerLost
from dgrasp.rl.cores import cores
from raisim_like.engines import steps_in_threads


def pool_kind(config: Config) -> str:
    """The kind of pool that `auto` stands for: threads where the engine steps in parallel threads, else processes."""
    if config.pool.kind == "thread" and config.engine == "pybullet":
        raise ConfigError("pool.kind: PyBullet cannot step worlds in threads; expected auto, process or serial")
    if config.pool.kind != "auto":
        return config.pool.kind
    return "thread" if steps_in_threads(config.engine) else "process"


def make_pool(spec: PoolSpec) -> Pool:
    """The pool that the config names; `workers: null` means one worker per core, on Ray one per CPU of the cluster."""
    kind, workers = pool_kind(spec.config), spec.config.pool.workers or cores()
    if kind in ("serial", "thread"):
        from dgrasp.pool.serial import SerialPool

        return SerialPool(spec, min(workers, len(spec.labels)) if kind == "thread" else 1)
    if kind == "ray":
        from dgrasp.pool.ray import RayPool

        return RayPool(spec)
    from dgrasp.pool.process import ProcessPool

    return ProcessPool(spec, workers)


__all__ = ["Pool", "PoolError", "PoolSpec", "WorkerLost", "cores", "make_pool", "pool_kind"]
