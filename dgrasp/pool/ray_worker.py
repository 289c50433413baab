"""The worker on a Ray cluster and the values that it returns."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from dgrasp.control.motion import Fingers
from dgrasp.env.grasp_env import Mode
from dgrasp.pool.base import PoolSpec, make_env
from dgrasp.pool.worker import Told
from dgrasp.rl.collect import Actor, Incident, Trajectories, collect
from dgrasp.rl.step import Step
from dgrasp.scene.state import copy_state, state_size, state_views
from dgrasp.types import Array


class Collected(NamedTuple):
    """A worker's answer for an epoch of its environments."""

    trajectories: Trajectories
    incidents: list[Incident]
    told: Told


class Stepped(NamedTuple):
    """A worker's answer for a step, a reset or a new phase. state: all arrays of its `SceneState` in one block."""

    step: Step
    state: Array
    told: Told


class RayWorker:
    """Some environments of the pool; its methods run on a machine of the cluster."""

    def __init__(self, spec: PoolSpec, rows: slice) -> None:
        self.env = make_env(spec, rows)
        self.indices = self.env.indices
        self._block = np.zeros(self.env.num_envs * state_size(spec.hand.layout))
        self._state = state_views(self.env.num_envs, spec.hand.layout, self._block)
        self._trajectories: Trajectories | None = None

    def process_id(self) -> int:
        """The id of the worker's process; an answer also shows that the environments have been made."""
        return os.getpid()

    def collect(self, actor: Actor, epoch: int, steps: int) -> Collected:
        env = self.env
        if self._trajectories is None or len(self._trajectories.reward) != steps:
            sizes = (steps, env.num_envs, env.observation_size, env.action_size, len(env.reward_terms))
            self._trajectories = Trajectories.allocate(*sizes)
        incidents = collect(env, actor, epoch, self.indices, self._trajectories, lambda steps: None)
        return Collected(self._trajectories, incidents, self.tell())

    def tell(self) -> Told:
        told = Told(self.env.seconds_per_env, self.env.steps_made, self.env.events, [])
        self.env.events = []
        return told

    def reset(self, epoch: int, mode: Mode) -> Stepped:
        self.env.reset(epoch, mode)
        return self._stepped()

    def step(self, actions: Array) -> Stepped:
        self.env.step(actions)
        return self._stepped()

    def remove_table(self) -> Stepped:
        self.env.remove_table()
        return self._stepped()

    def begin_motion(self, path: Array, fingers: Fingers) -> Stepped:
        self.env.begin_motion(path, fingers)
        return self._stepped()

    def _stepped(self) -> Stepped:
        copy_state(self.env.s, self._state, slice(None))
        return Stepped(self.env.o, self._block, self.tell())
