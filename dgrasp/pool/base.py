"""A pool of environments: the learner's `VecEnv` plus the phases that evaluation needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from dgrasp.config.experiment import Config
from dgrasp.control.motion import Fingers
from dgrasp.env.features import FeatureLayer
from dgrasp.env.grasp_env import GraspEnv, Mode
from dgrasp.env.registry import ENVS
from dgrasp.env.rewards import Reward
from dgrasp.errors import DGraspError
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import ObjectModel
from dgrasp.rl.collect import Actor, Incident
from dgrasp.rl.step import Step
from dgrasp.rl.vec_env import VecEnv
from dgrasp.types import Array, GraspLabel, SceneState

POLL_S = 0.2
"""Interval (s) at which a pool checks the progress of a collection."""
LOSSES_IN_A_ROW = 3
"""After this many losses of a worker without a success in between, a pool gives up."""


class PoolError(DGraspError):
    """A worker failed permanently; the message holds its traceback or the reason."""


class WorkerLost(DGraspError):
    """A worker died or hung during a test. A new worker has its environments; the test must start over.

    exit_code: of the process, if it died.
    """

    def __init__(self, message: str, exit_code: int | None = None) -> None:
        super().__init__(message)
        self.exit_code = exit_code


@dataclass(frozen=True)
class PoolSpec:
    """The specification of a pool, which has one environment per label.

    grasp: the frozen grasping policy; in task "motion" it makes the grasps, in task "flat" it determines which grasps
    are stable.
    """

    labels: Sequence[GraspLabel]
    hand: HandModel
    objects: Mapping[str, ObjectModel]
    config: Config
    grasp: Actor | None = None


def make_env(spec: PoolSpec, rows: slice = slice(None), threads: int = 1) -> GraspEnv:
    """Make the environments of some labels, of the kind that `env.task` names. threads: see `GraspEnv`."""
    indices = list(range(len(spec.labels)))[rows]
    labels = [spec.labels[i] for i in indices]
    kind, total = ENVS[spec.config.env.task], len(spec.labels)
    return kind(labels, spec.hand, spec.objects, spec.config, indices, total, grasp=spec.grasp, threads=threads)


class SizedPool:
    """The attributes of a pool that follow from its specification, without making an environment."""

    def __init__(self, spec: PoolSpec) -> None:
        self.labels = spec.labels
        self.num_envs = len(spec.labels)
        self.names = tuple(label.name for label in spec.labels)
        env, self.hand = spec.config.env, spec.hand.layout
        self.action_size = ENVS[env.task].actions(self.hand)
        layer = FeatureLayer(env, self.hand)
        self.observation_size, self.actor_size = layer.size, layer.actor_size
        self.reward_terms = Reward(env.reward, self.hand, env.task).names
        self._events: list[str] = []
        self._incidents: list[Incident] = []

    def drain_events(self) -> list[str]:
        events, self._events = self._events, []
        return events

    def drain_incidents(self) -> list[Incident]:
        incidents, self._incidents = self._incidents, []
        return incidents


class Pool(VecEnv, Protocol):
    """The interface of all pools: collection for the learner, and the steps and phases of a test."""

    labels: Sequence[GraspLabel]
    state: SceneState
    """States of all environments after the last reset or step; kept current only in modes "test" and "label"."""

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        """Start all episodes (see `GraspEnv.reset`); return the observations (N, O).

        This and the next three methods raise `WorkerLost` if a worker is lost; call `reset` again to start over.
        """

    def step(self, actions: Array) -> Step:
        """Apply the actions (N, A) float32, dimensionless, for one control step."""

    def remove_table(self) -> None:
        """Begin the stability test in all environments."""

    def begin_motion(self, path: Array, fingers: Fingers = "policy") -> None:
        """Begin the motion along the path of targets (N, P, 4, 4) in all environments (see `GraspEnv.begin_motion`).

        Updates the observations of the last step to the first targets.
        """

    def close(self) -> None:
        """Free all worlds and end all processes."""
