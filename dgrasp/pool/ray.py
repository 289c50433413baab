"""Environments on the machines of a Ray cluster. One call collects a whole epoch, because a call takes milliseconds.

A worker holds one part of the environments. To collect an epoch, the pool puts the policy into the cluster's object
store once. Each worker fetches it, makes all control steps and returns its trajectories. A worker that dies is started
again on any machine with a free CPU; its experience of the epoch is dropped. The pool does not wait for a late worker,
so a slow machine costs experience but not time (`pool.patience`).

Every machine needs this package, and the object meshes under the same paths (a shared file system).
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from dgrasp.control.motion import Fingers
from dgrasp.env.grasp_env import Mode
from dgrasp.errors import ConfigError
from dgrasp.pool.base import LOSSES_IN_A_ROW, POLL_S, PoolError, PoolSpec, SizedPool, WorkerLost
from dgrasp.pool.ray_worker import Collected, RayWorker, Stepped
from dgrasp.pool.worker import Told
from dgrasp.rl.collect import Actor, Trajectories
from dgrasp.rl.step import Step
from dgrasp.scene.state import copy_state, state_views
from dgrasp.types import Array

_SAY_AFTER_S = 30.0
"""Time (s) after which the pool reports that it is waiting for a busy cluster."""
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


class RayPool(SizedPool):
    """See `Pool`."""

    def __init__(self, spec: PoolSpec) -> None:
        super().__init__(spec)
        try:
            import ray
        except ImportError:
            raise ConfigError("pool.kind=ray needs the package ray: pip install 'dgrasp[ray]'") from None
        self._ray, self._config = ray, spec.config.pool
        self._ours = not ray.is_initialized()
        if self._ours:
            self._connect()
        self._members: list[Any] = []
        """Handles of the workers."""
        try:
            self._workers = self._fitting_workers()
            self._rows = [slice(w, self.num_envs, self._workers) for w in range(self._workers)]
            self._remote = ray.remote(num_cpus=1, runtime_env={"env_vars": _ONE_THREAD})(RayWorker)
            self._spec_ref = ray.put(spec)
            self._members = [self._remote.remote(self._spec_ref, rows) for rows in self._rows]
            self._await_ready()
        except BaseException:
            self.close()
            raise
        self.state = state_views(self.num_envs, self.hand)
        self._out = Step.allocate(self.num_envs, self.observation_size, len(self.reward_terms))
        self._trajectories: Trajectories | None = None
        self._lost, self._losses = 0, [0] * self._workers
        self._late: dict[int, Any] = {}
        """Workers still busy with an epoch that ended without them: the pending answer, and when it became late."""
        self._told, self._physics = np.zeros(self._workers), 0.0
        self._start = (time.perf_counter(), 0.0)

    def _connect(self) -> None:
        """Join the cluster at `pool.address`, or start one on this machine."""
        # A library must not send usage statistics without consent.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        # By default Ray lowers the priority of its workers; here the learner waits for them.
        os.environ.setdefault("RAY_worker_niceness", "0")
        address = self._config.address
        try:
            if address is None:
                self._ray.init(include_dashboard=False, log_to_driver=False, num_cpus=self._config.workers)
            else:
                self._ray.init(address=address, log_to_driver=False)
        except Exception as error:  # Ray raises many kinds of errors, and all of them mean that there is no cluster
            raise ConfigError(
                f"pool.address: cannot reach a Ray cluster at {address!r} ({error}); expected auto, HOST:PORT, or null "
                "for one on this machine"
            ) from None

    def _fitting_workers(self) -> int:
        """The number of workers; `ConfigError` if the cluster has fewer CPUs than that."""
        cpus = int(self._ray.cluster_resources().get("CPU", 0))
        workers = max(1, min(self._config.workers or cpus, self.num_envs))
        if workers > cpus:
            # The pool would wait forever for workers without a CPU.
            raise ConfigError(
                f"pool.workers: {workers} workers need one CPU each, but the Ray cluster has {cpus}; expected at most "
                "that, or null for one worker per CPU"
            )
        return workers

    def _await_ready(self) -> None:
        ready = [member.process_id.remote() for member in self._members]
        _, late = self._ray.wait(ready, num_returns=len(ready), timeout=_SAY_AFTER_S)
        if late:
            free = int(self._ray.available_resources().get("CPU", 0))
            print(f"waiting for {len(late)} of {len(ready)} workers, which need one CPU each; free CPUs in the Ray "
                  f"cluster: {free}", file=sys.stderr, flush=True)
        for w in range(self._workers):
            try:
                self._ray.get(ready[w])
            except self._ray.exceptions.RayTaskError as error:
                raise PoolError(f"worker {w} failed:\n{error}") from None
            except self._ray.exceptions.RayError as error:
                message = f"worker {w} could not start ({error}); is there enough memory for its worlds?"
                raise PoolError(message) from None

    # What a learner needs ----------------------------------------------------------------------

    def collect(self, actor: Actor, epoch: int, steps: int, advance: Callable[[int], None]) -> Trajectories:
        self._begin()
        if self._trajectories is None or len(self._trajectories.reward) != steps:
            sizes = (steps, self.num_envs, self.observation_size, self.action_size, len(self.reward_terms))
            self._trajectories = Trajectories.allocate(*sizes)
        self._trajectories.valid[:] = False
        self._drop_what_came_late()
        weights = self._ray.put(actor)
        asked = [w for w in range(self._workers) if w not in self._late]
        pending = {self._members[w].collect.remote(weights, epoch, steps): w for w in asked}
        started, took = time.monotonic(), list[float]()
        try:
            while pending:
                done, _ = self._ray.wait(list(pending), num_returns=1, timeout=POLL_S)
                now = time.monotonic() - started
                for answer in done:
                    w = pending.pop(answer)
                    if self._take(w, answer):
                        took.append(now)
                        advance(int(self._trajectories.part(self._rows[w]).valid.sum()) * steps)
                # A worker is late once it exceeds `patience` times the median of those that have finished.
                half = len(took) >= max(1, (len(asked) + 1) // 2)
                if half and now > max(self._config.patience * statistics.median(took), POLL_S):
                    break
        finally:
            for answer, w in pending.items():
                self._late[w] = (answer, time.monotonic())
        for w in pending.values():
            self._events.append(f"worker {w} is late; the experience of its environments in this epoch is dropped")
        return self._trajectories

    def _take(self, w: int, answer: Any) -> bool:
        """Copy a worker's answer into the trajectories; False if the worker was lost and has been replaced."""
        assert self._trajectories is not None
        try:
            got: Collected = self._ray.get(answer)
        except self._ray.exceptions.RayTaskError as error:
            raise PoolError(f"worker {w} failed:\n{error}") from None
        except self._ray.exceptions.RayError:
            self._replace(w, "died; the experience of its environments in this epoch is dropped")
            return False
        for name, array in vars(self._trajectories.part(self._rows[w])).items():
            array[...] = getattr(got.trajectories, name)
        self._incidents += got.incidents
        self._hear(w, got.told)
        self._losses[w] = 0
        return True

    def _drop_what_came_late(self) -> None:
        """Return late workers that have finished to service; replace those that exceed `pool.hang_s`."""
        for w, (answer, since) in list(self._late.items()):
            done, _ = self._ray.wait([answer], timeout=0)
            if done:
                del self._late[w]
                with suppress(self._ray.exceptions.RayError):
                    self._hear(w, self._ray.get(answer).told)
            elif time.monotonic() - since > self._config.hang_s:
                del self._late[w]
                self._replace(w, f"hung for {self._config.hang_s:g} s (pool.hang_s)")

    def _replace(self, w: int, why: str) -> None:
        """Replace a worker by a new one with the same environments, on any machine with a free CPU.

        why: completes the message "worker w ...". `PoolError` after too many losses in a row.
        """
        self._events.append(f"worker {w} {why}")
        self._losses[w] += 1
        self._lost += 1
        if self._losses[w] >= LOSSES_IN_A_ROW:
            times = self._losses[w]
            raise PoolError(f"worker {w} was lost {times} times in a row; is there enough memory for its worlds?")
        with suppress(self._ray.exceptions.RayError):
            self._ray.kill(self._members[w])
        self._members[w] = self._remote.remote(self._spec_ref, self._rows[w])
        self._told[w] = 0.0

    def _hear(self, w: int, told: Told) -> None:
        seconds = float(told.seconds.sum())
        self._physics += seconds - self._told[w]
        self._told[w] = seconds
        self._events += told.events

    def _begin(self) -> None:
        self._start = (time.perf_counter(), self._physics)

    def timing(self) -> dict[str, float]:
        wall, physics = time.perf_counter() - self._start[0], self._physics - self._start[1]
        share = physics / max(wall * self._workers, 1e-9)
        return {"physics_share": share, "physics_s": physics, "wall_s": wall, "workers": float(self._workers),
                "lost_workers": float(self._lost)}  # fmt: skip

    # Steps and phases of a test ----------------------------------------------------------------

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        self._begin()
        for w in list(self._late):
            del self._late[w]
        self._all(lambda w: self._members[w].reset.remote(epoch, mode))
        return self._out.observation

    def step(self, actions: Array) -> Step:
        self._all(lambda w: self._members[w].step.remote(actions[self._rows[w]]))
        return self._out

    def remove_table(self) -> None:
        self._all(lambda w: self._members[w].remove_table.remote())

    def begin_motion(self, path: Array, fingers: Fingers = "policy") -> None:
        self._all(lambda w: self._members[w].begin_motion.remote(path[self._rows[w]], fingers))

    def _all(self, call: Callable[[int], Any]) -> None:
        """Make a call in every worker and copy the results.

        Lost workers are replaced; `WorkerLost` is then raised, because they have returned nothing.
        """
        answers, lost = [call(w) for w in range(self._workers)], []
        for w, answer in enumerate(answers):
            try:
                stepped: Stepped = self._ray.get(answer, timeout=self._config.hang_s)
            except self._ray.exceptions.RayTaskError as error:
                raise PoolError(f"worker {w} failed:\n{error}") from None
            except (self._ray.exceptions.RayError, TimeoutError) as error:
                self._replace(w, "was lost in a test")
                lost.append(f"worker {w}: {type(error).__name__}")
                continue
            self._losses[w] = 0
            rows = self._rows[w]
            self._out.write(rows, stepped.step)
            copy_state(state_views(len(range(self.num_envs)[rows]), self.hand, stepped.state), self.state, rows)
            self._hear(w, stepped.told)
        if lost:
            raise WorkerLost("; ".join(lost))

    def close(self) -> None:
        for member in self._members:
            with suppress(Exception):
                self._ray.kill(member)
        self._members = []
        if self._ours:
            self._ray.shutdown()
