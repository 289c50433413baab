"""A trained grasping policy. With wrist guidance and closed-loop motion synthesis it is the paper's own method."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from dgrasp.config.sections import MotionConfig
from dgrasp.files.typed import typed
from dgrasp.methods.method import Method
from dgrasp.types import Array

if TYPE_CHECKING:
    from dgrasp.rl.networks import Policy


class PolicyMethod(Method):
    """A trained policy that acts without exploration noise from the start of the approach (paper, section 4.4).

    cfg, cfg_keys: the config and the keys with which train.py trains such a policy.
    """

    name = "policy"
    takes_policy = "must"
    cfg: ClassVar[str] = "cfg/dexycb.yaml"
    cfg_keys: ClassVar[tuple[str, ...]] = ()

    def __init__(self, policy: Policy) -> None:
        self.policy = policy

    @classmethod
    def train_command(cls) -> str:
        """The command line that trains such a policy."""
        return typed("train", ["--cfg", cls.cfg, *cls.cfg_keys])

    @classmethod
    def needs_grasp(cls, motion: MotionConfig) -> bool:
        """Whether its environments or the choice of its labels need the frozen policy `motion.policy`."""
        return False

    def act(self, observation: Array) -> Array:
        """Actions (N, A): the means of the policy."""
        return self.policy.act(observation)
