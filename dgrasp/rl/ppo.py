"""Proximal policy optimisation (Schulman et al. 2017): the losses and the update."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from dgrasp.config.sections import PpoConfig
from dgrasp.errors import DataError
from dgrasp.rl.adam import Adam
from dgrasp.rl.cores import cores
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.storage import Minibatch, Rollout

STATISTICS = (
    "surrogate_loss", "value_loss", "entropy", "kl", "clip_fraction", "grad_norm",
    "learning_rate", "action_std", "explained_variance",
)  # fmt: skip
"""Keys of the dictionary that `Ppo.update` returns."""

_KL_TOLERANCE = 2.0
_KL_ROUNDING = 1e-9
_RATE_FACTOR = 1.5
_SMALLEST_STD = 1e-6
_RETURN_RATE = 0.1


def surrogate_loss(ratio: Tensor, advantages: Tensor, clip: float) -> Tensor:
    """-mean(min(ratio A, clamp(ratio, 1 - clip, 1 + clip) A)), equation 7; all arguments are (B,)."""
    clipped = ratio.clamp(1.0 - clip, 1.0 + clip)
    return -torch.min(ratio * advantages, clipped * advantages).mean()


def value_loss(values: Tensor, old_values: Tensor, returns: Tensor, clip: float | None) -> Tensor:
    """Mean squared error of the values (B,).

    clip: the distance from the old values beyond which a value cannot lower the loss, in the unit of the arguments:
    mean(max((V - R)^2, (V_old + clamp(V - V_old, -clip, clip) - R)^2)). None: no limit.
    """
    error = (values - returns).square()
    if clip is None:
        return error.mean()
    clipped = old_values + (values - old_values).clamp(-clip, clip)
    return torch.max(error, (clipped - returns).square()).mean()


def gaussian_kl(old_mean: Tensor, old_std: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    """KL(old || new) (B,) between independent normals with means (B, A) and standard deviations (A,)."""
    of_std = torch.log(std / old_std) + 0.5 * ((old_std / std).square() - 1.0)
    of_mean = 0.5 * ((old_mean - mean) / std).square()
    return of_mean.sum(-1) + of_std.sum()


def adapted_learning_rate(rate: float, kl: float, config: PpoConfig) -> float:
    """The learning rate adapted to a measured KL, within the config's limits.

    Divided by 1.5 if the KL is above twice `desired_kl`, multiplied by 1.5 if it is below half of it. A KL of zero
    (up to rounding) leaves the rate as it is, because the policy has made no step yet.
    """
    if kl > _KL_TOLERANCE * config.desired_kl:
        return max(config.min_learning_rate, rate / _RATE_FACTOR)
    if _KL_ROUNDING < kl < config.desired_kl / _KL_TOLERANCE:
        return min(config.max_learning_rate, rate * _RATE_FACTOR)
    return rate


class Ppo:
    """Updates a model from rollouts, with one Adam optimiser for actor, critic and standard deviation."""

    def __init__(self, model: ActorCritic, config: PpoConfig) -> None:
        self.model, self.config = model, config
        # One kernel updates all parameters, where the device has it.
        fused = model.std.device.type in ("cpu", "cuda")
        self.optimizer = Adam(model.parameters(), lr=config.learning_rate, fused=fused)

    @property
    def learning_rate(self) -> float:
        """The present learning rate."""
        return float(self.optimizer.param_groups[0]["lr"])

    @learning_rate.setter
    def learning_rate(self, rate: float) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = rate

    def update(self, rollout: Rollout, generator: torch.Generator) -> dict[str, float]:
        """Update the model on a rollout whose returns have been computed.

        generator: a CPU generator that shuffles the samples. Returns the `STATISTICS`: learning_rate and action_std
        after the update, explained_variance of the returns by the old values, and the others as means over all
        minibatches. Raises `DataError` if the gradient is not finite.
        """
        statistics = {"explained_variance": _explained_variance(rollout.values, rollout.returns).item()}
        if self.config.normalise_returns:
            self._track_returns(rollout.returns)
        # Nothing has changed the standard deviation since the rollout was collected.
        old_std = self.model.std.detach().clone()
        rows = []
        with self._second_thread() as second:
            for _ in range(self.config.update_epochs):
                for batch in rollout.minibatches(self.config.minibatches, generator if self.config.shuffle else None):
                    rows.append(self._step(batch, old_std, second))
        # As in the authors' code, the floor is applied after the whole update.
        self.model.floor_std(max(self.config.min_std, _SMALLEST_STD))
        for name in rows[0]:
            statistics[name] = sum(row[name] for row in rows) / len(rows)
        statistics["learning_rate"] = self.learning_rate
        statistics["action_std"] = self.model.std.mean().item()
        return {name: statistics[name] for name in STATISTICS}

    @contextmanager
    def _second_thread(self) -> Iterator[Executor | None]:
        """A thread in which the critic learns beside the actor; None on one core, and on a GPU.

        The networks share no parameters, so the result is the same to the bit.
        """
        if self.model.std.device.type != "cpu" or cores() == 1:
            yield None
            return
        # A new thread would take torch's default number of threads of its own.
        with ThreadPoolExecutor(1, "dgrasp-critic", torch.set_num_threads, (torch.get_num_threads(),)) as second:
            yield second

    def _step(self, batch: Minibatch, old_std: Tensor, second: Executor | None) -> dict[str, float]:
        self.optimizer.zero_grad()
        if second is None:
            of_value = self._critic_backward(batch)
            row = self._actor_backward(batch, old_std)
        else:
            critic = second.submit(self._critic_backward, batch)
            row = self._actor_backward(batch, old_std)
            of_value = critic.result()
        grad_norm = self._clip_gradients()
        if not math.isfinite(grad_norm):
            raise DataError(
                f"the gradient of the PPO loss is not finite (surrogate loss {row['surrogate_loss']:g}, value loss "
                f"{of_value:g}, KL {row['kl']:g}, learning rate {self.learning_rate:g}); resume the last checkpoint "
                "with a smaller ppo.max_learning_rate"
            )
        self.optimizer.step()
        # An optimiser step can make a small standard deviation negative, where its logarithm is undefined.
        self.model.floor_std(_SMALLEST_STD)
        return {**row, "value_loss": of_value, "grad_norm": grad_norm}

    def _actor_backward(self, batch: Minibatch, old_std: Tensor) -> dict[str, float]:
        """Adapt the learning rate and compute the gradient of the actor's loss; return the actor's `STATISTICS`."""
        config = self.config
        now = self.model.density(batch.observations, batch.actions)
        with torch.no_grad():
            kl = gaussian_kl(batch.means, old_std, now.mean, now.std).mean().item()
        if config.adaptive_learning_rate:
            self.learning_rate = adapted_learning_rate(self.learning_rate, kl, config)
        ratio = (now.log_prob - batch.log_probs).exp()
        advantages = batch.advantages
        if config.advantages_per_minibatch:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        surrogate = surrogate_loss(ratio, advantages, config.clip)
        (surrogate - config.entropy_coefficient * now.entropy).backward()
        return {
            "surrogate_loss": surrogate.item(),
            "entropy": now.entropy.item(),
            "kl": kl,
            "clip_fraction": ((ratio - 1.0).abs() > config.clip).float().mean().item(),
        }

    def _critic_backward(self, batch: Minibatch) -> float:
        """Compute the gradient of the critic's loss; return the loss without its coefficient."""
        config = self.config
        # The critic's own unit: that of the returns unless they are normalised.
        unit = self.model.return_scale[1]
        loss = value_loss(
            self.model.value(batch.observations) / unit, batch.values / unit, batch.returns / unit,
            config.clip if config.clipped_value_loss else None,
        )  # fmt: skip
        (config.value_coefficient * loss).backward()
        return loss.item()

    def _clip_gradients(self) -> float:
        """Limit the norm of the gradient and return the norm before.

        One limit for actor and critic together, or with `separate_clipping` the same limit for each of them.
        """
        model, limit = self.model, self.config.max_grad_norm
        if not self.config.separate_clipping:
            return nn.utils.clip_grad_norm_(model.parameters(), limit).item()
        of_actor = nn.utils.clip_grad_norm_([*model.actor.parameters(), model.std], limit)
        of_critic = nn.utils.clip_grad_norm_(model.critic.parameters(), limit)
        return (of_actor.square() + of_critic.square()).sqrt().item()

    def _track_returns(self, returns: Tensor) -> None:
        """Track the mean and variance of the returns: the first epoch sets them, later epochs move them slowly."""
        mean, variance = returns.mean(), returns.var()
        if not torch.equal(self.model.return_scale.cpu(), torch.tensor([0.0, 1.0])):
            old_mean, old_std = self.model.return_scale
            mean = old_mean + _RETURN_RATE * (mean - old_mean)
            variance = old_std.square() + _RETURN_RATE * (variance - old_std.square())
        self.model.rescale_returns(mean, variance.sqrt().clamp(min=1e-3))


def _explained_variance(values: Tensor, returns: Tensor) -> Tensor:
    """1 - Var(R - V) / Var(R): 1 for a perfect critic, 0 for a constant one, NaN if the returns do not vary."""
    return 1.0 - (returns - values).var() / returns.var()
