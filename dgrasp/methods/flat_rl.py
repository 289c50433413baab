"""The baseline Flat-RL: one policy on phi and psi for the whole hand, trained end to end with the rewards of both."""

from __future__ import annotations

from dgrasp.config.sections import MotionConfig
from dgrasp.methods.target_policy import TargetPolicy


class FlatRl(TargetPolicy):
    """Flat-RL (supplement, section B.4), without phases: the policy sees the target from the first step.

    Its environment is `dgrasp.env.target_env.FlatEnv`. A frozen policy is needed only with `motion.stable_alone`, to
    choose the labels for training and testing.
    """

    name = "flat_rl"
    task = "flat"
    cfg = "cfg/flat_rl.yaml"
    grasps_first = False

    @classmethod
    def needs_grasp(cls, motion: MotionConfig) -> bool:
        return motion.stable_alone
