"""What can be evaluated: a trained policy, or a baseline of `dgrasp.baselines`."""

from __future__ import annotations

from typing import Protocol

from dgrasp.env.grasp_env import Mode
from dgrasp.rl.networks import Policy
from dgrasp.types import Array


class Method(Protocol):
    """How an evaluated episode starts, and what it does."""

    name: str
    mode: Mode

    def act(self, observation: Array) -> Array:
        """Actions (N, 51) for observations (N, O)."""


class PolicyMethod:
    """A trained policy, without exploration noise, from the start of the approach (paper, section 4.4)."""

    mode: Mode = "test"

    def __init__(self, policy: Policy, name: str = "policy") -> None:
        self.policy, self.name = policy, name

    def act(self, observation: Array) -> Array:
        return self.policy.act(observation)
