"""From a config to what runs: data, hand, objects, pool."""

from __future__ import annotations

from dgrasp.config.experiment import Config
from dgrasp.data import DataChoice
from dgrasp.errors import ConfigError
from dgrasp.hand.model import HandModel, load_hand
from dgrasp.methods.learned_motion import grasping_policy
from dgrasp.objects.free import free_object
from dgrasp.objects.model import ObjectModel
from dgrasp.objects.release import Concave, release_object
from dgrasp.objects.store import load_object
from dgrasp.pool import Pool, PoolSpec, make_pool
from dgrasp.rl.collect import Actor
from dgrasp.scene.standing import standing
from raisim_like.errors import EngineError
from raisim_like.registry import find_engine


def build_objects(choice: DataChoice, config: Config) -> dict[str, ObjectModel]:
    """The physics models of the objects that the chosen labels need."""
    physics = config.physics
    concave: Concave = "parts" if config.engine == "mujoco" else physics.concave

    def build(name: str) -> ObjectModel:
        if name in choice.added:
            return load_object(choice.added[name].folder, physics.official_compat, parts=concave == "parts")
        if choice.kind == "free":
            return free_object(name, physics.masses, physics.official_compat)
        return release_object(choice.objects_dir, name, physics.masses, physics.official_compat, concave)

    return {name: build(name) for name in choice.labels.objects}


def build_hand(choice: DataChoice) -> HandModel:
    """The chosen hand."""
    return load_hand(choice.hand_urdf, choice.hand)


def build_spec(choice: DataChoice, config: Config) -> PoolSpec:
    """What a pool for the chosen labels is made of.

    `ConfigError` for an engine that is not installed, and for a `motion.policy` that cannot make the grasps of a task.
    """
    try:
        find_engine(config.engine)
    except EngineError as error:
        raise ConfigError(f"engine: {error}") from None
    grasp = frozen_policy(config)
    objects = build_objects(choice, config)
    return PoolSpec(standing(choice.labels.labels, objects), build_hand(choice), objects, config, grasp)


def frozen_policy(config: Config) -> Actor | None:
    """The policy of `motion.policy`, where the task needs one: to grasp with, or to say which grasps are stable."""
    task = config.env.task
    needed = task == "motion" or (task == "flat" and config.motion.stable_alone)
    return grasping_policy(config).arrays() if needed else None


def build_pool(choice: DataChoice, config: Config) -> Pool:
    """One environment per chosen label, in the pool that the config names."""
    return make_pool(build_spec(choice, config))
