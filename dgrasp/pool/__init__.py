"""Pools that run environments. `serial` is the reference; tests check that `process` equals it to the bit."""

from __future__ import annotations

import os

from dgrasp.pool.base import Pool, PoolError, PoolSpec, WorkerLost


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def make_pool(spec: PoolSpec) -> Pool:
    """The pool that the config names; `workers: null` means one worker per core (`process`) or CPU (`ray`)."""
    if spec.config.pool.kind == "serial":
        from dgrasp.pool.serial import SerialPool

        return SerialPool(spec)
    if spec.config.pool.kind == "ray":
        from dgrasp.pool.ray import RayPool

        return RayPool(spec)
    from dgrasp.pool.process import ProcessPool

    return ProcessPool(spec, spec.config.pool.workers or cores())


__all__ = ["Pool", "PoolError", "PoolSpec", "WorkerLost", "cores", "make_pool"]
