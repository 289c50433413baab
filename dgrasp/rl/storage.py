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
    """An epoch of T control steps and N environments as float32 tensors on the learner's device."""

    def __init__(self, device: torch.device) -> None:
        self._device = device

    def load(self, trajectories: Trajectories, model: ActorCritic) -> None:
        """Take over an epoch of experience, and what the model that made it says of it.

        Environments that were not collected to the end are left out.
        """
        t = trajectories.valid_part()
        # On the CPU these are views of the trajectories, which stay until the next epoch.
        self.observations, self.actions = self._tensor(t.observations), self._tensor(t.actions)
        self.rewards = self._tensor(t.reward)
        self.terminated, self.truncated = self._tensor(t.terminated), self._tensor(t.truncated)
        self.means = torch.empty_like(self.actions)
        self.values, self.log_probs = torch.empty_like(self.rewards), torch.empty_like(self.rewards)
        with torch.no_grad():
            for step, (observation, action) in enumerate(zip(self.observations, self.actions, strict=True)):
                said = model.evaluate(observation, action)
                self.means[step], self.values[step], self.log_probs[step] = said.mean, said.value, said.log_prob
            self.last_values = model.value(self._tensor(t.last_observation))
            finals = model.value(self._tensor(t.final_observations).flatten(0, 1)).view(-1, self.rewards.shape[1])
        # The k-th truncated episode of an environment ended where its truncations count k.
        order = (self.truncated.cumsum(0) - 1).clamp(min=0)
        self.final_values = finals.gather(0, order)

    def _tensor(self, array: Array) -> Tensor:
        return torch.from_numpy(array).to(self._device)

    def compute_returns(self, gamma: float, lam: float) -> None:
        """Advantages and returns (advantage + value).

        The end of the rollout is a time limit, not an end of the task, so it bootstraps from the values of
        what came last; so does a truncated episode, from its own last observation. A terminated one has
        nothing to come.
        """
        next_values = torch.cat([self.values[1:], self.last_values[None]])
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
        order = torch.randperm(self.rewards.numel(), generator=generator).to(self._device)
        for chosen in order.tensor_split(count):
            yield Minibatch(*(array[chosen] for array in flat))
