"""The baseline "Ours+learned policy": a policy on psi moves the wrist of a hand that a frozen policy closes."""

from __future__ import annotations

from pathlib import Path

from dgrasp.config.experiment import Config
from dgrasp.config.sections import SENSES, EnvConfig
from dgrasp.env.features import FeatureLayer
from dgrasp.errors import ConfigError
from dgrasp.hand.layout import HandLayout
from dgrasp.methods.policy import PolicyMethod
from dgrasp.rl.networks import Policy
from dgrasp.rl.run.policies import SavedPolicy, read_policy


class LearnedMotion(PolicyMethod):
    """Supplement, section A.2. The grasp belongs to the environment (`dgrasp.env.target_env.MotionEnv`).

    Trained by `python train.py --cfg cfg/learned_motion.yaml motion.policy=FILE.pt`.
    """

    name = "learned_motion"
    task = "motion"

    def __init__(self, policy: Policy) -> None:
        super().__init__(policy, self.name)


def grasping_policy(config: Config, hand: HandLayout | None = None) -> Policy:
    """The policy of `motion.policy`; `ConfigError` if it is not named, or would not see and do what it learned.

    hand: the hand that it is to move, where that is known already.
    """
    if config.motion.policy is None:
        raise ConfigError("motion.policy: expected the checkpoint of a grasping policy, such as "
                          "motion.policy=runs/dexycb_1/best.pt or one of the authors'")
    path = Path(config.motion.policy).expanduser()
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
    # The authors' policies were trained with what the defaults are.
    there = saved.env or EnvConfig().model_dump(mode="json")
    here = env.model_dump(mode="json")
    differ = [key for key in SENSES if key in there and there[key] != here[key]]
    if differ:
        listed = "; ".join(f"env.{key} is {there[key]!r} there, {here[key]!r} here" for key in differ)
        raise ConfigError(f"motion.policy: {path} was trained with another config ({listed}); set these keys as there")
