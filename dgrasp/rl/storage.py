"""The rollout of one epoch, T control steps of N environments, and its advantages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from dgrasp.rl.networks import Acted
from dgrasp.types import Array

_ADVANTAGE_EPS = 1e-8


class Minibatch(NamedTuple):
    """B samples of a rollout: observations (B, O), actions and their means (B, A), the rest (B,).

    advantages are normalised over the whole rollout.
    """

    observations: Tensor
    actions: Tensor
    means: Tensor
    log_probs: Tensor
    values: Tensor
    returns: Tensor
    advantages: Tensor


def generalised_advantages(
    rewards: Tensor, values: Tensor, next_values: Tensor, done: Tensor, gamma: float, lam: float
) -> Tensor:
    """Generalised advantage estimates (T, N), Schulman et al. 2016, equation 16.

    A_t = delta_t + gamma lam A_{t+1} within an episode, delta_t = r_t + gamma V'_t - V_t.
    All arguments are (T, N). next_values: V' of the state that step t led to, 0 if it is terminal.
    done: the episode ended with step t, terminated or truncated, so A_{t+1} belongs to another episode.
    """
    deltas = rewards + gamma * next_values - values
    carry = gamma * lam * (~done)
    advantages = torch.empty_like(rewards)
    running = torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        running = deltas[t] + carry[t] * running
        advantages[t] = running
    return advantages


class Rollout:
    """Preallocated float32 storage [T, N], filled step by step with `observe` and `record`."""

    def __init__(
        self, steps: int, num_envs: int, observation_size: int, action_size: int, device: torch.device
    ) -> None:
        def buffer(*size: int) -> Tensor:
            return torch.zeros(steps, num_envs, *size, device=device)

        self.steps, self.num_envs = steps, num_envs
        self.observations = buffer(observation_size)
        self.actions, self.means = buffer(action_size), buffer(action_size)
        self.log_probs, self.values, self.rewards = buffer(), buffer(), buffer()
        self.terminated, self.truncated = buffer().bool(), buffer().bool()
        self.final_values, self.advantages, self.returns = buffer(), buffer(), buffer()
        self._device = device
        self._step = 0

    def clear(self) -> None:
        """Start again at step 0."""
        self._step = 0

    def observe(self, observation: Array) -> Tensor:
        """Copy the observations (N, O) of the present step into the rollout and return them on its device."""
        row = self.observations[self._step]
        row.copy_(torch.tensor(observation))
        return row

    def record(
        self, acted: Acted, reward: Array, terminated: Array, truncated: Array, final_values: Tensor | None
    ) -> None:
        """Store what followed from the observations of the present step, and go to the next.

        final_values: (N,) value of the last observation where an episode was truncated; None if none was.
        """
        t = self._step
        self.actions[t].copy_(acted.action)
        self.means[t].copy_(acted.mean)
        self.log_probs[t].copy_(acted.log_prob)
        self.values[t].copy_(acted.value)
        self.rewards[t].copy_(torch.tensor(reward))
        self.terminated[t].copy_(torch.tensor(terminated))
        self.truncated[t].copy_(torch.tensor(truncated))
        if final_values is not None:
            self.final_values[t].copy_(final_values)
        self._step += 1

    def compute_returns(self, last_values: Tensor, gamma: float, lam: float) -> None:
        """Advantages and returns (advantage + value).

        last_values: (N,) value of the observation after the last step. The end of the rollout is a time
        limit, not an end of the task, so it bootstraps; so does a truncated episode, from its own last
        observation. A terminated one has nothing to come.
        """
        next_values = torch.cat([self.values[1:], last_values[None]])
        next_values = torch.where(self.truncated, self.final_values, next_values)
        next_values = torch.where(self.terminated, 0.0, next_values)
        done = self.terminated | self.truncated
        self.advantages = generalised_advantages(self.rewards, self.values, next_values, done, gamma, lam)
        self.returns = self.advantages + self.values

    def minibatches(self, count: int, generator: torch.Generator | None) -> Iterator[Minibatch]:
        """All T N samples once, in `count` parts of (nearly) equal size.

        generator: shuffles the samples; None keeps them in order of time, as the authors do.
        """
        advantages = (self.advantages - self.advantages.mean()) / (self.advantages.std() + _ADVANTAGE_EPS)
        arrays = (self.observations, self.actions, self.means, self.log_probs, self.values, self.returns, advantages)
        flat = [array.flatten(0, 1) for array in arrays]
        if generator is None:
            yield from (Minibatch(*parts) for parts in zip(*(a.tensor_split(count) for a in flat), strict=True))
            return
        order = torch.randperm(self.steps * self.num_envs, generator=generator).to(self._device)
        for chosen in order.tensor_split(count):
            yield Minibatch(*(array[chosen] for array in flat))
