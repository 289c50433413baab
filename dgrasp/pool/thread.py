"""Environments in threads of this process: for engines whose step runs without the interpreter's lock.

Each thread has its own environments, as a worker process of `dgrasp.pool.process` has, and makes all control steps of
an epoch without waiting for the others. The threads share the time of the interpreter: what is computed outside of the
engine's step runs in one thread at a time. Nothing is copied between processes, and no process has to start.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from functools import partial
from typing import TypeVar

import numpy as np

from dgrasp.control.motion import Fingers
from dgrasp.env.grasp_env import GraspEnv, Mode
from dgrasp.pool.balance import BALANCE_AFTER, costs, worthwhile
from dgrasp.pool.base import POLL_S, PoolSpec, SizedPool, Stopped, make_env
from dgrasp.rl.collect import Actor, Incident, Trajectories, collect
from dgrasp.rl.step import Step
from dgrasp.scene.state import copy_state, state_views
from dgrasp.types import Array

T = TypeVar("T")


class ThreadPool(SizedPool):
    """See `Pool`."""

    def __init__(self, spec: PoolSpec, workers: int) -> None:
        super().__init__(spec)
        self._spec, self._workers = spec, max(1, min(workers, self.num_envs))
        self.state = state_views(self.num_envs, self.hand)
        self._out = Step.allocate(self.num_envs, self.observation_size, len(self.reward_terms))
        self._trajectories: Trajectories | None = None
        self._stop = False
        self._collections = 0
        self._retired = np.zeros((2, self.num_envs))
        """Seconds inside the engine and control steps made, by environment, in worlds that were replaced."""
        self._threads = ThreadPoolExecutor(self._workers, "dgrasp-worker")
        self._envs: list[GraspEnv] = []
        self._divide([slice(w, self.num_envs, self._workers) for w in range(self._workers)])
        self._start = (time.perf_counter(), 0.0)

    def _divide(self, rows: list[slice]) -> None:
        """Give each thread the environments of its rows."""
        self._close_envs()
        self._rows = rows
        self._envs = list(self._threads.map(partial(make_env, self._spec), rows))

    def _close_envs(self) -> None:
        """Free all worlds."""
        for env in self._envs:
            env.close()
        self._envs = []

    def _each(self, act: Callable[[GraspEnv, slice], T]) -> list[T]:
        """Call `act` for the environments and rows of every thread, in that thread."""
        return list(self._threads.map(act, self._envs, self._rows))

    @property
    def _spent(self) -> Array:
        """(2, N) seconds inside the engine and control steps made, by environment."""
        spent = self._retired.copy()
        for env, rows in zip(self._envs, self._rows, strict=True):
            spent[:, rows] += env.seconds_per_env, env.steps_made
        return spent

    # What a learner needs ----------------------------------------------------------------------

    def collect(self, actor: Actor, epoch: int, steps: int, advance: Callable[[int], None]) -> Trajectories:
        self._begin()
        if self._collections in BALANCE_AFTER:
            self._balance()
        if self._trajectories is None or len(self._trajectories.reward) != steps:
            sizes = (steps, self.num_envs, self.observation_size, self.action_size, len(self.reward_terms))
            self._trajectories = Trajectories.allocate(*sizes)
        counts, self._stop = np.zeros(self._workers, int), False
        jobs = [
            self._threads.submit(self._collect, w, actor, epoch, self._trajectories.part(rows), counts)
            for w, rows in enumerate(self._rows)
        ]
        told = 0
        try:
            waiting = True
            while waiting:
                done, open_jobs = wait(jobs, POLL_S, FIRST_EXCEPTION)
                waiting = bool(open_jobs) and not any(job.exception() for job in done)
                made = int(counts.sum())
                advance(made - told)
                told = made
        finally:
            # After an exception, the threads stop after their present control step.
            self._stop = True
            wait(jobs)
        for error in (job.exception() for job in jobs):
            if error is not None and not isinstance(error, Stopped):
                raise error
        for job in jobs:
            self._incidents += job.result()
        self._collections += 1
        return self._trajectories

    def _collect(self, w: int, actor: Actor, epoch: int, out: Trajectories, counts: Array) -> list[Incident]:
        def advance(steps: int) -> None:
            counts[w] += steps
            if self._stop:
                raise Stopped

        return collect(self._envs[w], actor, epoch, self._envs[w].indices, out, advance)

    def _balance(self) -> None:
        """Divide the environments again if the measured costs make it worthwhile."""
        spent = self._spent
        rows = worthwhile(costs(*spent), self._rows)
        if rows is not None:
            self._retired = spent
            self._divide(rows)

    def timing(self) -> dict[str, float]:
        wall, physics = time.perf_counter() - self._start[0], float(self._spent[0].sum()) - self._start[1]
        share = physics / max(wall * self._workers, 1e-9)
        return {"physics_share": share, "physics_s": physics, "wall_s": wall, "workers": float(self._workers)}

    def drain_events(self) -> list[str]:
        for env in self._envs:
            self._events += env.events
            env.events = []
        return super().drain_events()

    # Steps and phases of a test ----------------------------------------------------------------

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        self._begin()

        def act(env: GraspEnv, rows: slice) -> None:
            env.reset(epoch, mode)
            self._write(env, rows)

        self._each(act)
        return self._out.observation

    def step(self, actions: Array) -> Step:
        def act(env: GraspEnv, rows: slice) -> None:
            env.step(actions[rows])
            self._write(env, rows)

        self._each(act)
        return self._out

    def remove_table(self) -> None:
        self._each(lambda env, rows: env.remove_table())

    def begin_motion(self, path: Array, fingers: Fingers = "policy") -> None:
        def act(env: GraspEnv, rows: slice) -> None:
            env.begin_motion(path[rows], fingers)
            self._write(env, rows)

        self._each(act)

    def _write(self, env: GraspEnv, rows: slice) -> None:
        """Copy the results of a step into the pool's arrays; the states only outside training."""
        self._out.write(rows, env.o)
        if env.mode != "train":
            copy_state(env.s, self.state, rows)

    def _begin(self) -> None:
        self._start = (time.perf_counter(), float(self._spent[0].sum()))

    def close(self) -> None:
        self._threads.shutdown()
        self._close_envs()
