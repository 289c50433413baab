"""The interface of a method: how its episodes start, how it acts, and the other properties that the program needs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, ClassVar, Literal, Protocol

from dgrasp.config.experiment import Config
from dgrasp.config.sections import MotionConfig
from dgrasp.control.motion import Fingers
from dgrasp.env.grasp_env import Mode
from dgrasp.errors import ConfigError
from dgrasp.geometry.intersection import Body
from dgrasp.pool import PoolSpec
from dgrasp.types import Array

Bodies = Callable[[], Mapping[str, Body]]
"""Builds the surfaces of the objects, by name, in their frames O. Only methods that need them call it."""


class Method(Protocol):
    """A trained policy or a baseline. Methods inherit from this class and override what differs.

    name: its name in `--baseline` and in results. mode: how its episodes start (`GraspEnv.reset`). task: its
    `env.task`. motion: whether it moves objects to targets: never, only if `motion.targets` is set (may), or always.
    takes_policy: whether it is made from a saved policy. grasps_first: whether a motion begins after
    `env.grasp_steps` control steps of grasping; if False, the first target is shown from the first step.
    """

    name: str
    mode: Mode = "test"
    task: str = "grasp"
    motion: ClassVar[Literal["never", "may", "always"]] = "may"
    takes_policy: ClassVar[Literal["no", "may", "must"]] = "no"
    grasps_first: ClassVar[bool] = True

    @classmethod
    def check_policy(cls, given: bool) -> None:
        """Check whether a saved policy is given; `ConfigError` if the method cannot use one or lacks one."""
        refused = {"no": True, "may": None, "must": False}
        if given == refused[cls.takes_policy]:
            raise ConfigError("what to test: expected one of --baseline, --run and --policy (--baseline static_grasp "
                              "can be combined with --run or --policy, which then makes the grasps)")

    @classmethod
    def make(cls, policy: Method | None, where: str) -> Method:
        """Make the method. policy: the method of the saved policy, if any. where: the name of that policy in errors."""
        assert policy is not None
        return policy

    def act(self, observation: Array) -> Array:
        """Actions (N, A) for observations (N, O)."""

    def check(self, config: Config) -> None:
        """`ConfigError` if the config's task is not the method's."""
        if self.task != config.env.task:
            raise ConfigError(f"{self.name} is for task {self.task}, but the config has env.task={config.env.task}; "
                              "expected the policy's own config: its --run, or --cfg RUN/config.yaml")

    def differences(self, data: Mapping[str, Any], objects: Collection[str]) -> list[str]:
        """In what the method is not the paper's on this data (`DataChoice.stamp`), such as what it was trained on.

        objects: those of the data.
        """
        return []

    def unseen(self, objects: Collection[str]) -> list[str]:
        """Those of `objects` that training left out."""
        return []

    def prepare(self, spec: PoolSpec, bodies: Bodies) -> PoolSpec:
        """The specification to simulate. A method may change it, for example correct the labels."""
        return spec

    def grasping(self, spec: PoolSpec) -> tuple[Method, PoolSpec]:
        """The method that makes the grasps of a motion, and the specification of the pool that tests them."""
        return self, spec

    def fingers(self, motion: MotionConfig) -> Fingers:
        """What controls the fingers during a motion."""
        return "policy"

    def describe(self, motion: MotionConfig) -> dict[str, Any]:
        """The method's part of a result's `motion`: how the wrist moves, what controls the fingers, what grasps."""
        beta = {"position": motion.beta_position, "rotation": motion.beta_rotation,
                "ramp_position": motion.ramp_position, "ramp_rotation": motion.ramp_rotation}
        return {"beta": beta, "fingers": self.fingers(motion), "grasp": self.name}
