"""The base class of policies that see the object's target."""

from __future__ import annotations

from typing import Any

from dgrasp.config.sections import MotionConfig
from dgrasp.errors import ConfigError
from dgrasp.methods.frozen import frozen_grasp
from dgrasp.methods.method import Method
from dgrasp.methods.policy import PolicyMethod
from dgrasp.pool import PoolSpec


class TargetPolicy(PolicyMethod):
    """A policy of a task with targets: trained and tested by moving objects to them (`dgrasp.env.target_env`)."""

    motion = "always"

    @classmethod
    def check_policy(cls, given: bool) -> None:
        """`ConfigError` if no policy is given; the message says how to train one."""
        if not given:
            raise ConfigError(f"--baseline {cls.name} needs a policy trained for it: expected --run DIR too. "
                              f"To train one: {cls.train_command()}")

    @classmethod
    def make(cls, policy: Method | None, where: str) -> Method:
        """The policy itself; `ConfigError` if it is of another task."""
        if not isinstance(policy, cls):
            task = "none" if policy is None else policy.task
            raise ConfigError(f"{where}: not a policy of {cls.name} but one of task {task}; expected one trained with: "
                              f"{cls.train_command()}")
        return policy

    def grasping(self, spec: PoolSpec) -> tuple[Method, PoolSpec]:
        """The frozen policy `motion.policy`, with a pool of task "grasp"."""
        return frozen_grasp(spec)

    def describe(self, motion: MotionConfig) -> dict[str, Any]:
        """As for other methods, but with the scale of the wrist's actions instead of the closed loop's gain."""
        sigma = {"position": motion.sigma_position, "rotation": motion.sigma_rotation}
        return {"fingers": self.fingers(motion), "grasp": self.name, "sigma": sigma}
