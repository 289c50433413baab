"""Collect experience in the process that holds the environments: a plain numpy actor and the arrays it fills."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from dgrasp.errors import DataError
from dgrasp.rl.step import Layout, Step
from dgrasp.types import Array

LEAK = 0.01
"""Slope of the networks' LeakyReLU for negative inputs."""


@dataclass(frozen=True)
class Actor:
    """A Gaussian policy as numpy arrays, which lets a worker act without torch.

    layers: (weight (out, in), bias (out,)) float32 of each layer. std: (A,) float32. seed: seed of the noise.
    """

    layers: tuple[tuple[Array, Array], ...]
    std: Array
    seed: int

    def means(self, observations: Array, out: Array) -> None:
        """Write the mean actions (n, A) for observations (n, O) into `out`.

        The network reads the first columns of the observations, as many as its first layer has inputs. Rows are
        computed one by one, so the result for a row does not depend, to the bit, on the other rows.
        """
        # A stack of matrix-vector products: NumPy computes them one by one.
        x = observations[:, : self.layers[0][0].shape[1], None]
        for weight, bias in self.layers[:-1]:
            x = np.matmul(weight, x)
            x += bias[:, None]
            x = np.maximum(x, LEAK * x)
        weight, bias = self.layers[-1]
        np.matmul(weight, x, out=out[:, :, None])
        out += bias

    def noise(self, epoch: int, index: int, steps: int) -> Array:
        """(steps, A) standard normal float32 noise of one environment in one epoch."""
        # The spawn key separates this stream from others derived from the same numbers.
        sequence = np.random.SeedSequence([self.seed, epoch, index], spawn_key=(2,))
        return np.random.default_rng(sequence).standard_normal((steps, len(self.std)), dtype=np.float32)


@dataclass
class Trajectories:
    """T control steps of N environments; the first axis is time.

    observations: (T, N, O), actions: (T, N, A), reward: (T, N), reward_terms: (N, K) summed over time, all float32.
    terminated, truncated: (T, N) bool. last_observation: (N, O), after the last step.
    final_observations: (F, N, O), the last observations of each environment's truncated episodes, in order.
    valid: (N,) bool, false where an environment took no part or a lost worker left its rows unfinished.
    """

    observations: Array
    actions: Array
    reward: Array
    terminated: Array
    truncated: Array
    last_observation: Array
    final_observations: Array
    reward_terms: Array
    valid: Array

    @staticmethod
    def layout(steps: int, envs: int, observation: int, action: int, terms: int, finals: int = 1) -> Layout:
        """Shape and type of each array. finals: how many episodes of one environment may be truncated."""
        return {
            "observations": ((steps, envs, observation), np.float32),
            "actions": ((steps, envs, action), np.float32),
            "reward": ((steps, envs), np.float32),
            "terminated": ((steps, envs), np.bool_),
            "truncated": ((steps, envs), np.bool_),
            "last_observation": ((envs, observation), np.float32),
            "final_observations": ((finals, envs, observation), np.float32),
            "reward_terms": ((envs, terms), np.float32),
            "valid": ((envs,), np.bool_),
        }

    @classmethod
    def allocate(cls, *sizes: int) -> Trajectories:
        """Arrays of zeros; sizes as for `layout`."""
        return cls(**{name: np.zeros(shape, kind) for name, (shape, kind) in cls.layout(*sizes).items()})

    def part(self, envs: slice) -> Trajectories:
        """Views of the arrays of some environments."""
        return Trajectories(**{k: v[envs] if k in _PER_ENV else v[:, envs] for k, v in vars(self).items()})

    def valid_part(self) -> Trajectories:
        """The trajectories of valid environments: this object itself if all are valid, otherwise copies."""
        if self.valid.all():
            return self
        rows = np.flatnonzero(self.valid)
        return Trajectories(**{k: v[rows] if k in _PER_ENV else v[:, rows] for k, v in vars(self).items()})


_PER_ENV = ("last_observation", "reward_terms", "valid")


class Incident(NamedTuple):
    """What is needed to replay an episode in which the simulation broke.

    Environment `env` was reset for `epoch` and took the actions (t, A); the simulation broke at the last one. The
    actions start at the reset, so they include earlier episodes of the same epoch.
    """

    env: int
    epoch: int
    actions: Array


class Steppable(Protocol):
    """Environments in this process. Environments that are not `active` after a reset take no part in the epoch."""

    @property
    def active(self) -> Array: ...
    def reset(self, epoch: int) -> Array: ...
    def step(self, actions: Array) -> Step: ...


def collect(
    env: Steppable,
    actor: Actor,
    epoch: int,
    indices: Sequence[int],
    out: Trajectories,
    advance: Callable[[int], None],
) -> list[Incident]:
    """Fill `out` with one epoch of the n environments in `env`; return the episodes in which the simulation broke.

    indices: the place of each environment in the whole set. advance: called after every control step with the number
    of environments that made it; an exception from it ends the collection. Raises `DataError` if an observation or
    reward is not finite.
    """
    steps, n, n_actions = out.actions.shape
    action = np.zeros((n, n_actions), np.float32)
    finals = np.zeros(n, int)
    incidents: list[Incident] = []
    out.reward_terms[:] = 0.0
    observation = env.reset(epoch)
    _check_finite(observation, "observation", indices, epoch, 0)
    active = env.active
    acting = np.flatnonzero(active)
    noise = np.empty((steps, len(acting), n_actions), np.float32)
    for k, row in enumerate(acting.tolist()):
        noise[:, k] = actor.noise(epoch, indices[row], steps)
    noise *= actor.std
    means = np.empty((len(acting), n_actions), np.float32)
    for t in range(steps):
        out.observations[t] = observation
        actor.means(observation if len(acting) == n else observation[acting], means)
        action[acting] = means + noise[t]
        out.actions[t] = action
        result = env.step(action)
        observation = result.observation
        _check_finite(observation, "observation", indices, epoch, t + 1)
        _check_finite(result.reward, "reward", indices, epoch, t + 1)
        out.reward[t], out.terminated[t], out.truncated[t] = result.reward, result.terminated, result.truncated
        out.reward_terms += result.reward_terms
        rows = np.flatnonzero(result.truncated)
        if len(rows):
            final = result.final_observation[rows]
            _check_finite(final, "final observation", [indices[row] for row in rows.tolist()], epoch, t + 1)
            out.final_observations[finals[rows], rows] = final
            finals[rows] += 1
        for row in np.flatnonzero(result.broken).tolist():
            incidents.append(Incident(indices[row], epoch, out.actions[: t + 1, row].copy()))
        advance(len(acting))
    out.last_observation[:] = observation
    out.valid[:] = active
    return incidents


def _check_finite(array: Array, name: str, indices: Sequence[int], epoch: int, step: int) -> None:
    if np.isfinite(array).all():
        return
    place = np.argwhere(~np.isfinite(array))[0]
    env, entry = indices[int(place[0])], f", entry {place[1]}," if len(place) > 1 else ""
    raise DataError(
        f"environment {env}, epoch {epoch}, step {step}: the {name}{entry} is {array[tuple(place)]}; "
        "expected finite numbers. The environment must end an unstable episode itself"
    )
