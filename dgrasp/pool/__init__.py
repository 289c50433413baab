"""Pools that run environments. `serial` is the reference; tests check that the others equal it to the bit.

`thread` is the serial pool with worlds that step side by side.
"""

from __future__ import annotations

from dgrasp.config.experiment import Config
from dgrasp.errors import ConfigError
from dgrasp.pool.base import Pool, PoolError, PoolSpec, WorkerLost
from dgrasp.rl.cores import cores
from raisim_like.engines import steps_in_threads
from raisim_like.registry import TOGETHER


def pool_kind(config: Config) -> str:
    """The kind of pool; `auto` stands for the best one of the engine.

    An engine that advances all worlds of a process at once takes them all in this process ("serial"); one that steps in
    parallel threads takes threads; the others take processes. Raises `ConfigError` for a kind that does not fit.
    """
    if config.engine in TOGETHER:
        if config.pool.kind not in ("auto", "serial"):
            raise ConfigError(f"pool.kind: the engine {config.engine} advances all worlds together in one process, "
                              f"which {config.pool.kind!r} would divide; expected auto or serial")
        return "serial"
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
