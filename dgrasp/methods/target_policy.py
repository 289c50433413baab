"""What the policies that see the object's target have in common."""

from __future__ import annotations

from typing import Any

from dgrasp.config.sections import MotionConfig
from dgrasp.errors import ConfigError
from dgrasp.methods.frozen import frozen_grasp
from dgrasp.methods.method import Method
from dgrasp.methods.policy import PolicyMethod
from dgrasp.pool import PoolSpec


class TargetPolicy(PolicyMethod):
    """A policy of its own task, trained and tested by moving objects to targets (`dgrasp.env.target_env`)."""

    motion = "always"

    @classmethod
    def check_policy(cls, given: bool) -> None:
        """`ConfigError` without a policy, which says how to train one."""
        if not given:
            raise ConfigError(f"--baseline {cls.name} is a policy of its own: expected --run DIR too. "
                              f"To train one: {cls.train_command()}")

    @classmethod
    def make(cls, policy: Method | None, where: str) -> Method:
        """The policy; `ConfigError` for one of another task."""
        if not isinstance(policy, cls):
            task = "none" if policy is None else policy.task
            raise ConfigError(f"{where}: not a policy of {cls.name} but one of task {task}; expected one that was made "
                              f"by: {cls.train_command()}")
        return policy

    def grasping(self, spec: PoolSpec) -> tuple[Method, PoolSpec]:
        """The frozen policy `motion.policy`, in the task of grasping."""
        return frozen_grasp(spec)

    def describe(self, motion: MotionConfig) -> dict[str, Any]:
        """How far an action moves the wrist, in place of the closed loop's gain."""
        sigma = {"position": motion.sigma_position, "rotation": motion.sigma_rotation}
        return {"fingers": self.fingers(motion), "grasp": self.name, "sigma": sigma}
