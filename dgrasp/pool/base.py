"""A pool of environments: the learner's `VecEnv` with the phases that evaluation needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from dgrasp.config import Config
from dgrasp.env.grasp_env import Mode
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import ObjectModel
from dgrasp.rl.vec_env import Step
from dgrasp.types import Array, GraspLabel, SceneState


@dataclass(frozen=True)
class PoolSpec:
    """What a pool is made of: one environment per label."""

    labels: Sequence[GraspLabel]
    hand: HandModel
    objects: Mapping[str, ObjectModel]
    config: Config


class Pool(Protocol):
    """Environments that step together, wherever they run."""

    labels: Sequence[GraspLabel]
    state: SceneState
    """States of all environments after the last reset or step; kept current in modes test and label alone."""

    @property
    def num_envs(self) -> int:
        """N, one environment per label."""

    @property
    def observation_size(self) -> int:
        """Length of an observation."""

    @property
    def action_size(self) -> int:
        """Length of an action."""

    @property
    def reward_terms(self) -> tuple[str, ...]:
        """Names of the reward's terms."""

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        """Start all episodes (see `GraspEnv.reset`); returns the observations (N, O)."""

    def step(self, actions: Array) -> Step:
        """One control step with actions (N, A)."""

    def remove_table(self) -> None:
        """Begin the stability test in all environments."""

    def timing(self) -> dict[str, float]:
        """Since the last reset: `physics_share` of the workers' wall time, `physics_s`, `wall_s`, `workers`."""

    def drain_events(self) -> list[str]:
        """What happened since the last call that a person should read."""

    def close(self) -> None:
        """Free worlds and processes."""
