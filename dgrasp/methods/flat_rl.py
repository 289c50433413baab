"""The baseline Flat-RL: one policy on phi and psi for everything, with the rewards of both, trained end to end."""

from __future__ import annotations

from dgrasp.config.sections import MotionConfig
from dgrasp.methods.target_policy import TargetPolicy


class FlatRl(TargetPolicy):
    """Supplement, section B.4: no phases, so its target is there from the first step; `dgrasp.env.target_env.FlatEnv`.

    A frozen policy only tells which labels are trained and tested on, with `motion.stable_alone`.
    """

    name = "flat_rl"
    task = "flat"
    cfg = "cfg/flat_rl.yaml"
    grasps_first = False

    @classmethod
    def needs_grasp(cls, motion: MotionConfig) -> bool:
        return motion.stable_alone
