"""The baseline "Ours+static grasp": once the grasp is there, the fingers only hold while the wrist moves."""

from __future__ import annotations

from typing import Any

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.config.sections import MotionConfig
from dgrasp.control.motion import Fingers
from dgrasp.errors import ConfigError
from dgrasp.methods.method import Method
from dgrasp.methods.pd import PdBaseline
from dgrasp.types import Array


class StaticGrasp(Method):
    """Paper, section 4.1. In the motion the fingers' PD targets stay (`motion.static_fingers`), whatever `grasp` says.

    grasp: what makes the grasp and is tested for stability: a policy, or by default PD in the label's pose.
    """

    name = "static_grasp"
    motion = "always"
    takes_policy = "may"

    def __init__(self, grasp: Method | None = None) -> None:
        self.grasp = grasp or PdBaseline()
        self.mode = self.grasp.mode
        self.task = self.grasp.task

    @classmethod
    def make(cls, policy: Method | None, where: str) -> Method:
        """With the grasps of a policy, or without one."""
        return cls(policy)

    def act(self, observation: Array) -> Array:
        """Actions (N, D) of the grasp."""
        return np.asarray(self.grasp.act(observation))

    def check(self, config: Config) -> None:
        """As for others; and the policy must be one of grasping."""
        super().check(config)
        if self.task != "grasp":
            raise ConfigError(f"--baseline static_grasp: a policy of task {self.task} makes no grasp to hold; expected "
                              "a grasping policy")

    def fingers(self, motion: MotionConfig) -> Fingers:
        """They hold their pose or their last PD targets."""
        return motion.static_fingers

    def describe(self, motion: MotionConfig) -> dict[str, Any]:
        """As for others, with the method that makes the grasps."""
        return super().describe(motion) | {"grasp": self.grasp.name}
