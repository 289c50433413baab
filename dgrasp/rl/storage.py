"""The rollout of one epoch, T control steps of N environments, and its advantages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from dgrasp.rl.collect import Trajectories
from dgrasp.rl.networks import ActorCritic
from dgrasp.types import Array

_ADVANTAGE_EPS = 1e-8


class Minibatch(NamedTuple):
    """B samples of a rollout: observations (B, O), actions and their means (B, A), the other fields (B,).

    The advantages are normalised over the whole rollout.
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
    The tensors are (T, N). next_values: V', the value of the state after step t, 0 if that state is terminal.
    done: whether the episode ended with step t (terminated or truncated), so that A_{t+1} belongs to another episode.
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
    """One epoch of T control steps of N environments as tensors on the learner's device, float32 except for flags."""

    def __init__(self, device: torch.device) -> None:
        self._device = device

    def load(self, trajectories: Trajectories, model: ActorCritic) -> None:
        """Load an epoch of experience and evaluate it with `model`, the model that collected it.

        Environments that are not `valid` are left out.
        """
        t = trajectories.valid_part()
        # On the CPU these are views of the trajectories, which stay unchanged until the next epoch.
        self.observations, self.actions = self._tensor(t.observations), self._tensor(t.actions)
        self.rewards = self._tensor(t.reward)
        self.terminated, self.truncated = self._tensor(t.terminated), self._tensor(t.truncated)
        with torch.no_grad():
            said = model.density(self.observations, self.actions)
            self.means, self.log_probs, self.values = said.mean, said.log_prob, model.value(self.observations)
            self.last_values = model.value(self._tensor(t.last_observation))
            finals = model.value(self._tensor(t.final_observations).flatten(0, 1)).view(-1, self.rewards.shape[1])
        # The k-th truncated episode of an environment ends at the step where its running count of truncations is k.
        order = (self.truncated.cumsum(0) - 1).clamp(min=0)
        self.final_values = finals.gather(0, order)

    def _tensor(self, array: Array) -> Tensor:
        return torch.from_numpy(array).to(self._device)

    def compute_returns(self, gamma: float, lam: float) -> None:
        """Compute advantages and returns (advantage + value).

        The end of the rollout is a time limit, not an end of the task, so it bootstraps from the value of the last
        observation. A truncated episode bootstraps from the value of its own last observation. The value after a
        terminated episode is 0.
        """
        next_values = torch.cat([self.values[1:], self.last_values[None]])
        next_values = torch.where(self.truncated, self.final_values, next_values)
        next_values = torch.where(self.terminated, 0.0, next_values)
        done = self.terminated | self.truncated
        self.advantages = generalised_advantages(self.rewards, self.values, next_values, done, gamma, lam)
        self.returns = self.advantages + self.values

    def minibatches(self, count: int, generator: torch.Generator | None) -> Iterator[Minibatch]:
        """Yield all T N samples once, in `count` minibatches of (nearly) equal size.

        generator: shuffles the samples; None keeps them in order of time, as the authors' code does.
        """
        advantages = (self.advantages - self.advantages.mean()) / (self.advantages.std() + _ADVANTAGE_EPS)
        arrays = (self.observations, self.actions, self.means, self.log_probs, self.values, self.returns, advantages)
        flat = [array.flatten(0, 1) for array in arrays]
        if generator is None:
            yield from (Minibatch(*parts) for parts in zip(*(a.tensor_split(count) for a in flat), strict=True))
            return
        order = torch.randperm(self.rewards.numel(), generator=generator).to(self._device)
        for chosen in order.tensor_split(count):
            yield Minibatch(*(array[chosen] for array in flat))
