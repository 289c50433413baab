"""Actor and critic networks (supplement, table of PPO parameters: two hidden layers of 128, LeakyReLU)."""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from dgrasp.errors import DataError
from dgrasp.rl.collect import LEAK, Actor
from dgrasp.types import Array

_LOG_2PI = math.log(2.0 * math.pi)


class Density(NamedTuple):
    """The policy's present density of old actions: log_prob (...,), mean (..., A), std (A,), entropy ()."""

    log_prob: Tensor
    mean: Tensor
    std: Tensor
    entropy: Tensor


def gaussian_log_prob(action: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    """Log-density (B,) of actions (B, A) under independent normals with mean (B, A) and std (A,)."""
    scaled = (action - mean) / std
    return -0.5 * scaled.square().sum(-1) - std.log().sum() - 0.5 * std.numel() * _LOG_2PI


def _copy(parameter: Tensor) -> Array:
    array: Array = parameter.detach().cpu().numpy().copy()
    return array


def _layers(network: nn.Module) -> tuple[tuple[Array, Array], ...]:
    linear = [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
    return tuple((_copy(layer.weight), _copy(layer.bias)) for layer in linear)


def make_mlp(sizes: list[int], dtype: torch.dtype = torch.float32) -> nn.Sequential:
    """Linear layers of the given sizes with LeakyReLU between them; the global random state stays as it is."""
    layers: list[nn.Module] = []
    # nn.utils.skip_init would draw no numbers, but it imports sympy, which takes half a second.
    with torch.random.fork_rng(devices=[]):
        for fan_in, fan_out in itertools.pairwise(sizes):
            layers += [nn.Linear(fan_in, fan_out, dtype=dtype), nn.LeakyReLU(LEAK)]
    return nn.Sequential(*layers[:-1])


def _initialise(network: nn.Sequential, generator: torch.Generator, output_gain: float) -> None:
    """Set orthogonal weights with gain sqrt(2), as in the authors' code, and zero biases.

    A gain of sqrt(2) preserves the scale of activations through rectifiers. `output_gain` is the gain of the last
    layer; the published policies were trained with sqrt(2) there too. With zero biases the gain alone sets the scale
    of the outputs, and a zero observation gives mean and value zero.
    """
    for layer in network:
        if isinstance(layer, nn.Linear):
            gain = output_gain if layer is network[-1] else math.sqrt(2.0)
            nn.init.orthogonal_(layer.weight, gain=gain, generator=generator)
            nn.init.zeros_(layer.bias)


class ActorCritic(nn.Module):
    """A Gaussian policy and a value function: two networks that share no parameters.

    The standard deviation is one learned number per action, independent of the observation. As in the authors' code,
    the parameter is the standard deviation itself, not its logarithm, so an optimiser step of a given size changes a
    small standard deviation by a larger fraction.
    """

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        hidden: list[int],
        initial_std: float,
        generator: torch.Generator,
        actor_size: int | None = None,
        output_gain: float = math.sqrt(2.0),
    ) -> None:
        super().__init__()
        self.observation_size, self.action_size, self.hidden = observation_size, action_size, list(hidden)
        self.actor_size = observation_size if actor_size is None else actor_size
        self.actor = make_mlp([self.actor_size, *hidden, action_size])
        self.critic = make_mlp([observation_size, *hidden, 1])
        self.std = nn.Parameter(torch.full((action_size,), float(initial_std)))
        self.register_buffer("return_scale", torch.tensor([0.0, 1.0]))
        self.return_scale: Tensor
        """(2,) mean and standard deviation of the returns: value = network output * standard deviation + mean."""
        _initialise(self.actor, generator, output_gain)
        _initialise(self.critic, generator, math.sqrt(2.0))

    def actor_arrays(self, seed: int) -> Actor:
        """The present policy as arrays, for collecting experience. seed: seed of the exploration noise."""
        return Actor(_layers(self.actor), _copy(self.std), seed)

    def density(self, observation: Tensor, action: Tensor) -> Density:
        """The density of actions (..., A) taken at observations (..., O), with gradients. The critic takes no part."""
        mean = self.actor(observation[..., : self.actor_size])
        entropy = self.std.log().sum() + 0.5 * self.action_size * (1.0 + _LOG_2PI)
        return Density(gaussian_log_prob(action, mean, self.std), mean, self.std, entropy)

    def value(self, observation: Tensor) -> Tensor:
        """Values (...,) of observations (..., O), with gradients. The actor takes no part."""
        value: Tensor = self.critic(observation).squeeze(-1)
        return value * self.return_scale[1] + self.return_scale[0]

    @torch.no_grad()
    def rescale_returns(self, mean: Tensor, std: Tensor) -> None:
        """Change `return_scale` and correct the critic's last layer to keep all values (van Hasselt et al. 2016)."""
        last = self.critic[-1]
        assert isinstance(last, nn.Linear)
        old_mean, old_std = self.return_scale.clone()
        last.weight.mul_(old_std / std)
        last.bias.copy_((old_std * last.bias + old_mean - mean) / std)
        self.return_scale.copy_(torch.stack([mean, std]))

    @torch.no_grad()
    def mean_action(self, observation: Tensor) -> Tensor:
        """The deterministic actions (N, A) for observations (N, O)."""
        mean: Tensor = self.actor(observation[..., : self.actor_size])
        return mean

    @torch.no_grad()
    def floor_std(self, smallest: float) -> None:
        """Raise every standard deviation to at least `smallest`."""
        self.std.clamp_(min=smallest)

    def architecture(self) -> dict[str, Any]:
        """The properties that two models must share for one to load the other's weights."""
        return {
            "observation_size": self.observation_size,
            "actor_size": self.actor_size,
            "action_size": self.action_size,
            "hidden": list(self.hidden),
            "activation": "leaky_relu",
            "std": "independent",
        }

    def policy(self) -> Policy:
        """The deterministic policy. It shares the model's weights, so updates of the model change it too."""
        return Policy(self.actor, self.observation_size, self.action_size, self.actor_size)


def parameter_shapes(architecture: dict[str, Any]) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the parameters of an `ActorCritic` with this architecture."""
    action = architecture["action_size"]
    shapes: dict[str, tuple[int, ...]] = {"std": (action,), "return_scale": (2,)}
    for name, key, outputs in (("actor", "actor_size", action), ("critic", "observation_size", 1)):
        sizes = [architecture[key], *architecture["hidden"], outputs]
        for index, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
            shapes[f"{name}.{2 * index}.weight"] = (fan_out, fan_in)
            shapes[f"{name}.{2 * index}.bias"] = (fan_out,)
    return shapes


class Policy:
    """A deterministic policy that maps numpy arrays to numpy arrays, for evaluation."""

    def __init__(
        self, actor: nn.Module, observation_size: int, action_size: int, actor_size: int | None = None
    ) -> None:
        self._actor, self.observation_size, self.action_size = actor, observation_size, action_size
        self.actor_size = actor_size or observation_size
        parameter = next(actor.parameters())
        self._device, self._dtype = parameter.device, parameter.dtype

    def arrays(self) -> Actor:
        """The policy as float32 numpy arrays, without noise, for workers that do not use torch."""
        layers = tuple((w.astype(np.float32), b.astype(np.float32)) for w, b in _layers(self._actor))
        return Actor(layers, np.zeros(self.action_size, np.float32), seed=0)

    @torch.no_grad()
    def act(self, observation: Array) -> Array:
        """Actions (N, A) float32 for observations (N, O) float32; `DataError` for another shape of observations."""
        if observation.ndim != 2 or observation.shape[1] != self.observation_size:
            raise DataError(
                f"the policy takes observations of shape (N, {self.observation_size}), got {observation.shape}; "
                "use the hand and the features that it was trained with"
            )
        inputs = torch.tensor(observation[:, : self.actor_size], dtype=self._dtype, device=self._device)
        actions: Array = self._actor(inputs).cpu().numpy().astype(np.float32, copy=False)
        return actions
