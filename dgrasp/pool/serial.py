"""All environments in this process. With one thread, this pool is the reference that all others must equal."""

from __future__ import annotations

import time
from collections.abc import Callable

from dgrasp.control.motion import Fingers
from dgrasp.env.grasp_env import Mode
from dgrasp.pool.base import PoolSpec, make_env
from dgrasp.rl.collect import Actor, Incident, Trajectories, collect
from dgrasp.rl.step import Step
from dgrasp.types import Array


class SerialPool:
    """See `Pool`. threads: how many worlds step side by side; the result is the same to the bit."""

    def __init__(self, spec: PoolSpec, threads: int = 1) -> None:
        self.env, self._threads = make_env(spec, threads=threads), threads
        self.labels, self.state = spec.labels, self.env.s
        self.num_envs, self.action_size = self.env.num_envs, self.env.action_size
        self.observation_size, self.reward_terms = self.env.observation_size, self.env.reward_terms
        self.actor_size = self.env.layer.actor_size
        self._start = (time.perf_counter(), 0.0)
        self._trajectories: Trajectories | None = None
        self._incidents: list[Incident] = []
        self.names = tuple(label.name for label in spec.labels)

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        self._start = (time.perf_counter(), self.env.step_seconds)
        return self.env.reset(epoch, mode)

    def step(self, actions: Array) -> Step:
        return self.env.step(actions)

    def collect(self, actor: Actor, epoch: int, steps: int, advance: Callable[[int], None]) -> Trajectories:
        if self._trajectories is None or len(self._trajectories.reward) != steps:
            sizes = (steps, self.num_envs, self.observation_size, self.action_size, len(self.reward_terms))
            self._trajectories = Trajectories.allocate(*sizes)
        self._start = (time.perf_counter(), self.env.step_seconds)
        self._incidents += collect(self.env, actor, epoch, self.env.indices, self._trajectories, advance)
        return self._trajectories

    def remove_table(self) -> None:
        self.env.remove_table()

    def begin_motion(self, path: Array, fingers: Fingers = "policy") -> None:
        self.env.begin_motion(path, fingers)

    def timing(self) -> dict[str, float]:
        wall = time.perf_counter() - self._start[0]
        physics = self.env.step_seconds - self._start[1]
        share = physics / max(wall * self._threads, 1e-9)
        workers = float(self._threads)
        return {"physics_share": share, "physics_s": physics, "wall_s": wall, "workers": workers}

    def drain_events(self) -> list[str]:
        events, self.env.events = self.env.events, []
        return events

    def drain_incidents(self) -> list[Incident]:
        incidents, self._incidents = self._incidents, []
        return incidents

    def close(self) -> None:
        self.env.close()
