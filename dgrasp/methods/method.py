"""What a method is: how evaluated episodes start, what acts in them, and what the rest of the program asks of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
"""Makes the surfaces of the objects, by name, in their frames O; called by the methods that need them."""


class Method(Protocol):
    """A trained policy or a baseline. A method inherits from this class and overrides what differs.

    name: what `--baseline` and results call it. mode: how its episodes start (`GraspEnv.reset`). task: the `env.task`
    that it is for. motion: whether it moves objects to targets: never, where `motion.targets` is set, or always.
    takes_policy: whether it is made from a saved policy. grasps_first: whether a motion begins after
    `env.grasp_steps` control steps of grasping; False shows the first target from the first step.
    """

    name: str
    mode: Mode = "test"
    task: str = "grasp"
    motion: ClassVar[Literal["never", "may", "always"]] = "may"
    takes_policy: ClassVar[Literal["no", "may", "must"]] = "no"
    grasps_first: ClassVar[bool] = True

    @classmethod
    def check_policy(cls, given: bool) -> None:
        """`ConfigError` for a saved policy that the method has no use for, and for one that it lacks."""
        refused = {"no": True, "may": None, "must": False}
        if given == refused[cls.takes_policy]:
            raise ConfigError("what to test: expected one of --baseline, --run and --policy (--baseline static_grasp "
                              "may take its grasps from one of the others)")

    @classmethod
    def make(cls, policy: Method | None, where: str) -> Method:
        """The method, given what a saved policy is by itself; where: what names that policy in errors."""
        assert policy is not None
        return policy

    def act(self, observation: Array) -> Array:
        """Actions (N, A) for observations (N, O)."""

    def check(self, config: Config) -> None:
        """`ConfigError` for a config of another task than the method's."""
        if self.task != config.env.task:
            raise ConfigError(f"{self.name} is of task {self.task}, and the config of env.task={config.env.task}; "
                              "expected the policy's own config: its --run, or --cfg RUN/config.yaml")

    def prepare(self, spec: PoolSpec, bodies: Bodies) -> PoolSpec:
        """What is simulated, from what was chosen: a method may correct the labels first."""
        return spec

    def grasping(self, spec: PoolSpec) -> tuple[Method, PoolSpec]:
        """The method that makes the grasps of a motion, and the pool in which they are tested for stability."""
        return self, spec

    def fingers(self, motion: MotionConfig) -> Fingers:
        """What has the fingers during a motion."""
        return "policy"

    def describe(self, motion: MotionConfig) -> dict[str, Any]:
        """The method's part of a result's `motion`: how the wrist moves, and what has the fingers and the grasp."""
        beta = {"position": motion.beta_position, "rotation": motion.beta_rotation,
                "ramp_position": motion.ramp_position, "ramp_rotation": motion.ramp_rotation}
        return {"beta": beta, "fingers": self.fingers(motion), "grasp": self.name}
