"""Build what an experiment runs with from its config: objects, hand, pool."""

from __future__ import annotations

from itertools import zip_longest

from dgrasp.config.experiment import Config
from dgrasp.data import DataChoice
from dgrasp.errors import ConfigError, DataError
from dgrasp.hand.layout import HandLayout
from dgrasp.hand.model import HandModel
from dgrasp.methods import TRAINED
from dgrasp.methods.frozen import grasping_policy
from dgrasp.objects.free import free_object
from dgrasp.objects.model import ObjectModel
from dgrasp.objects.release import Concave, release_object
from dgrasp.objects.store import load_object
from dgrasp.pool import Pool, PoolSpec, make_pool
from dgrasp.rl.collect import Actor
from dgrasp.scene.standing import standing
from raisim_like.errors import EngineError
from raisim_like.registry import CONCAVE_MESHES, find_engine


def build_objects(choice: DataChoice, config: Config) -> dict[str, ObjectModel]:
    """The physics models of the objects that the chosen labels need."""
    physics = config.physics
    concave: Concave = physics.concave if config.engine in CONCAVE_MESHES else "parts"

    def build(name: str) -> ObjectModel:
        if name in choice.added:
            return load_object(choice.added[name].folder, physics.authors_inertia(False), parts=concave == "parts")
        if choice.kind == "free":
            return free_object(name, physics.masses, physics.authors_inertia(False))
        return release_object(choice.objects_dir, name, physics.masses, physics.authors_inertia(True), concave)

    return {name: build(name) for name in choice.labels.objects}


def build_hand(choice: DataChoice) -> HandModel:
    """The chosen hand. Raises `DataError` if its joints, parts or key points differ from those of the labels."""
    hand = choice.hand_source.load()
    for what in ("joints", "parts", "keypoints"):
        there, here = getattr(choice.labels.names, what), getattr(hand.layout.names, what)
        if there != here:
            other = next(pair for pair in zip_longest(there, here) if pair[0] != pair[1])
            raise DataError(f"{choice.labels.path}: labels of {len(there)} {what}, but the hand {hand.id!r} has "
                            f"{len(here)}; the first difference is {other[0]!r} in the labels, {other[1]!r} in the "
                            "hand; choose the hand that the labels were made for (hand=)")
    return hand


def require_engine(name: str, where: str) -> None:
    """Raise `ConfigError` if an engine is not installed. where: the key or option that names it."""
    try:
        find_engine(name)
    except EngineError as error:
        raise ConfigError(f"{where}: {error}") from None


def build_spec(choice: DataChoice, config: Config) -> PoolSpec:
    """The specification of a pool for the chosen labels.

    Raises `ConfigError` if the engine is not installed, or if `motion.policy` cannot make the grasps of the task.
    """
    require_engine(config.engine, "engine")
    hand = build_hand(choice)
    grasp = frozen_policy(config, hand.layout)
    objects = build_objects(choice, config)
    return PoolSpec(standing(choice.labels.labels, objects), hand, objects, config, grasp)


def frozen_policy(config: Config, hand: HandLayout | None = None) -> Actor | None:
    """The policy of `motion.policy` if the task needs one, to grasp or to find the stable grasps; else None."""
    return grasping_policy(config, hand).arrays() if TRAINED[config.env.task].needs_grasp(config.motion) else None


def build_pool(choice: DataChoice, config: Config) -> Pool:
    """A pool of the kind that the config names, with one environment per chosen label."""
    return make_pool(build_spec(choice, config))
