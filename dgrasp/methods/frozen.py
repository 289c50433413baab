"""The frozen grasping policy of the tasks with a target: how it is loaded, and the pool that tests its grasps."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dgrasp.config.experiment import Config, make_config
from dgrasp.config.sections import SENSES, EnvConfig
from dgrasp.env.features import FeatureLayer
from dgrasp.errors import ConfigError
from dgrasp.hand.layout import HandLayout
from dgrasp.methods.method import Method
from dgrasp.pool import PoolSpec
from dgrasp.rl.collect import Actor
from dgrasp.types import Array

if TYPE_CHECKING:
    from dgrasp.rl.networks import Policy
    from dgrasp.rl.run.policies import SavedPolicy


class FrozenGrasp(Method):
    """The frozen policy as a method, with the same numpy actor that the environments of task "motion" use."""

    name = "policy"

    def __init__(self, actor: Actor) -> None:
        self._actor = actor

    def act(self, observation: Array) -> Array:
        """Actions (N, A): the means of the policy."""
        actions = np.empty((len(observation), len(self._actor.std)), np.float32)
        self._actor.means(observation, actions)
        return actions


def frozen_grasp(spec: PoolSpec) -> tuple[FrozenGrasp, PoolSpec]:
    """The frozen policy of a pool, and the specification of the pool of task "grasp" that tests its grasps."""
    assert spec.grasp is not None
    env = spec.config.env.model_copy(update={"task": "grasp"})
    return FrozenGrasp(spec.grasp), dataclasses.replace(spec, config=spec.config.model_copy(update={"env": env}))


def grasping_policy(config: Config, hand: HandLayout | None = None) -> Policy:
    """The policy named by `motion.policy`.

    `ConfigError` if none is named, or if the policy is of another task, was trained with another input or output
    (`SENSES`), or takes another number of observations. hand: the hand that it will move, if already known.
    """
    if config.motion.policy is None:
        raise ConfigError("motion.policy: expected the checkpoint of a grasping policy, such as "
                          "motion.policy=runs/dexycb_1/best.pt or one of the authors'")
    from dgrasp.rl.run.policies import read_policy

    path = Path(os.path.expanduser(config.motion.policy))
    saved = read_policy(path)
    if saved.task != "grasp":
        raise ConfigError(f"motion.policy: {path} is a policy of task {saved.task}; expected one of task grasp")
    env = config.env.model_copy(update={"task": "grasp", "critic_features": False})
    _check_env(saved, env, path)
    expected = saved.policy.actor_size if hand is None else FeatureLayer(env, hand).size
    if saved.policy.actor_size != expected:
        raise ConfigError(f"motion.policy: {path} sees {saved.policy.actor_size} numbers; expected the {expected} of "
                          f"env.features={env.features}")
    return saved.policy


def _check_env(saved: SavedPolicy, env: EnvConfig, path: Path) -> None:
    # A key that a policy's config lacks is newer than the policy, which was trained with what is now its default. The
    # authors' policies, which carry no config, were trained with the default values.
    there = make_config({"env": saved.env}, str(path)).env.model_dump(mode="json")
    here = env.model_dump(mode="json")
    differ = [key for key in SENSES if there[key] != here[key]]
    if differ:
        listed = "; ".join(f"env.{key} is {there[key]!r} there, {here[key]!r} here" for key in differ)
        raise ConfigError(f"motion.policy: {path} was trained with another config ({listed}); use its values here")
