"""What can be evaluated: a trained policy, or a baseline of `dgrasp.methods`."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dgrasp.env.grasp_env import Mode
from dgrasp.rl.collect import Actor
from dgrasp.rl.networks import Policy
from dgrasp.types import Array


class Method(Protocol):
    """How an evaluated episode starts, and what it does."""

    name: str
    mode: Mode

    def act(self, observation: Array) -> Array:
        """Actions (N, A) for observations (N, O)."""


class PolicyMethod:
    """A trained policy, without exploration noise, from the start of the approach (paper, section 4.4)."""

    mode: Mode = "test"
    task = "grasp"
    """The `env.task` that such a policy is for."""

    def __init__(self, policy: Policy, name: str = "policy") -> None:
        self.policy, self.name = policy, name

    def act(self, observation: Array) -> Array:
        return self.policy.act(observation)


class FrozenGrasp:
    """The frozen grasping policy of task "motion", as its environments have it."""

    name = "policy"
    mode: Mode = "test"

    def __init__(self, actor: Actor) -> None:
        self._actor = actor

    def act(self, observation: Array) -> Array:
        actions = np.empty((len(observation), len(self._actor.std)), np.float32)
        self._actor.means(observation, actions)
        return actions
