"""A toy set of environments, in which a point on a line per action must reach a target, and training runs on it."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dgrasp.config.experiment import Config, make_config
from dgrasp.rl.collect import Actor, Incident, Trajectories, collect
from dgrasp.rl.run import checkpoint as checkpoints
from dgrasp.rl.run.checkpoint import Checkpoint
from dgrasp.rl.runner import Evaluate, Runner
from dgrasp.rl.step import Step
from dgrasp.types import Array

STEP_SIZE = 0.2
LIMIT = 4.0


class ToyEnv:
    """Observation: offset to the target and position. Reward: minus the distance, minus a small penalty on effort.

    An episode is terminated beyond LIMIT and truncated after `episode_steps`. All arrays are reused from
    call to call. `on_step(env, epoch, step)` may inject faults.
    """

    reward_terms = ("contact_reward", "effort")

    def __init__(
        self,
        num_envs: int = 8,
        dims: int = 2,
        episode_steps: int = 7,
        seed: int = 1,
        on_step: Callable[[ToyEnv, int, int], None] | None = None,
    ) -> None:
        self.num_envs, self.action_size, self.observation_size = num_envs, dims, 2 * dims
        self.episode_steps, self.seed, self.on_step = episode_steps, seed, on_step
        self.observation = np.zeros((num_envs, 2 * dims), np.float32)
        self.final = np.zeros_like(self.observation)
        self.reward = np.zeros(num_envs, np.float32)
        self.terms = np.zeros((num_envs, 2), np.float32)
        self.terminated, self.truncated = np.zeros(num_envs, bool), np.zeros(num_envs, bool)
        self.broken, self.active = np.zeros(num_envs, bool), np.ones(num_envs, bool)
        self.actor_size = self.observation_size
        self.events: list[str] = []
        self.incidents: list[Incident] = []
        self.names = tuple(f"toy/{env}" for env in range(num_envs))
        self.resets: list[int] = []

    def reset(self, epoch: int) -> Array:
        self.epoch, self.step_count = epoch, 0
        self.resets.append(epoch)
        self.rngs = [np.random.default_rng([self.seed, epoch, env]) for env in range(self.num_envs)]
        self.target, self.position = np.zeros((2, self.num_envs, self.action_size))
        self.age = np.zeros(self.num_envs, int)
        self._restart(np.arange(self.num_envs))
        self._observe(self.observation)
        return self.observation

    def step(self, actions: Array) -> Step:
        self.step_count += 1
        self.position += STEP_SIZE * actions
        self.age += 1
        self.terms[:, 0] = -np.abs(self.target - self.position).sum(1)
        self.terms[:, 1] = -0.01 * np.square(actions).sum(1)
        self.reward[:] = self.terms.sum(1)
        self._observe(self.final)
        self.terminated[:] = np.abs(self.position).max(1) > LIMIT
        self.truncated[:] = ~self.terminated & (self.age >= self.episode_steps)
        self._restart(np.flatnonzero(self.terminated | self.truncated))
        self._observe(self.observation)
        if self.on_step is not None:
            self.on_step(self, self.epoch, self.step_count)
        return Step(self.observation, self.final, self.reward, self.terms, self.terminated, self.truncated, self.broken)

    def collect(self, actor: Actor, epoch: int, steps: int, advance: Callable[[int], None]) -> Trajectories:
        finals = steps // self.episode_steps + 1
        out = Trajectories.allocate(
            steps, self.num_envs, self.observation_size, self.action_size, len(self.reward_terms), finals
        )
        self.incidents += collect(self, actor, epoch, range(self.num_envs), out, advance)
        return out

    def drain_incidents(self) -> list[Incident]:
        incidents, self.incidents = self.incidents, []
        return incidents

    def timing(self) -> dict[str, float]:
        return {"physics_share": 0.5}

    def drain_events(self) -> list[str]:
        events, self.events = self.events, []
        return events

    def _restart(self, envs: Array) -> None:
        for env in envs:
            self.target[env] = self.rngs[env].uniform(-1.0, 1.0, self.action_size)
            self.position[env] = 0.0
            self.age[env] = 0

    def _observe(self, out: Array) -> None:
        np.concatenate([self.target - self.position, self.position], axis=1, out=out, casting="same_kind")


def toy_config(**ppo: Any) -> Config:
    """A small experiment: 10 steps an epoch, so that the episodes of 7 steps end within it."""
    every = ppo.pop("every", 1)
    keep = ppo.pop("keep", 100)
    eval_every = ppo.pop("eval_every", 2)
    steps = ppo.pop("steps", 10)
    return make_config(
        {
            "seed": ppo.pop("seed", 1),
            "device": "cpu",
            "env": {"episode_steps": steps, "grasp_steps": 1},
            "checkpoint": {"every": every, "keep": keep},
            "eval": {"every": eval_every},
            "ppo": {"epochs": 4, "hidden": [16, 16], "update_epochs": 2, "minibatches": 2, **ppo},
        }
    )


def run(run_dir: Path, config: Config, resume: bool = False, evaluate: Evaluate | None = None, **env: Any) -> Runner:
    runner = Runner(ToyEnv(**env), config, run_dir, {"hand": "toy"}, evaluate, resume)
    runner.learn()
    return runner


def last(run_dir: Path) -> Checkpoint:
    return checkpoints.load(checkpoints.latest(run_dir))


def assert_same(a: Checkpoint, b: Checkpoint) -> None:
    assert a.epoch == b.epoch and a.learning_rate == b.learning_rate and a.best_success == b.best_success
    assert all(torch.equal(a.model[name], b.model[name]) for name in a.model)
    for index, moments in a.optimizer["state"].items():
        assert all(torch.equal(moments[name], b.optimizer["state"][index][name]) for name in moments)


def rows_of(run_dir: Path) -> list[dict[str, str]]:
    with open(run_dir / "progress.csv", newline="") as stream:
        return list(csv.DictReader(stream))
