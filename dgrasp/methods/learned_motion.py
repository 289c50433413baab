"""The baseline "Ours+learned policy": a policy on psi moves the wrist while a frozen policy controls the fingers."""

from __future__ import annotations

from typing import Any

from dgrasp.config.sections import MotionConfig
from dgrasp.methods.target_policy import TargetPolicy


class LearnedMotion(TargetPolicy):
    """Learned motion (supplement, section A.2). The environment makes the grasp (`dgrasp.env.target_env.MotionEnv`)."""

    name = "learned_motion"
    task = "motion"
    cfg = "cfg/learned_motion.yaml"
    cfg_keys = ("motion.policy=FILE.pt",)

    @classmethod
    def needs_grasp(cls, motion: MotionConfig) -> bool:
        return True

    def describe(self, motion: MotionConfig) -> dict[str, Any]:
        """As for other policies with a target, plus the frozen policy that makes the grasps."""
        return super().describe(motion) | {"grasp": str(motion.policy)}
