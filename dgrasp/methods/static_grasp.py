"""The baseline "Ours+static grasp": after the grasp, the fingers hold still while the wrist moves."""

from __future__ import annotations

from collections.abc import Collection, Mapping
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
    """Static grasp (paper, section 4.1). During the motion the fingers' PD targets are fixed (`motion.static_fingers`).

    grasp: the method that makes the grasp and is tested for stability: a policy, or by default PD in the label's pose.
    Its actions do not move the fingers during the motion.
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
        """Make the baseline with the grasps of a policy, or of PD if there is none."""
        return cls(policy)

    def act(self, observation: Array) -> Array:
        """Actions (N, D) of the method that makes the grasp."""
        return np.asarray(self.grasp.act(observation))

    def check(self, config: Config) -> None:
        """As for other methods; also `ConfigError` if the policy is not a grasping policy."""
        super().check(config)
        if self.task != "grasp":
            raise ConfigError(f"--baseline static_grasp: a policy of task {self.task} makes no grasp to hold; expected "
                              "a grasping policy")

    def differences(self, data: Mapping[str, Any], objects: Collection[str]) -> list[str]:
        """Those of the method that makes the grasps."""
        return self.grasp.differences(data, objects)

    def unseen(self, objects: Collection[str]) -> list[str]:
        """Those of the method that makes the grasps."""
        return self.grasp.unseen(objects)

    def fingers(self, motion: MotionConfig) -> Fingers:
        """The fingers hold their pose or their last PD targets."""
        return motion.static_fingers

    def describe(self, motion: MotionConfig) -> dict[str, Any]:
        """As for other methods, with the method that makes the grasps."""
        return super().describe(motion) | {"grasp": self.grasp.name}
