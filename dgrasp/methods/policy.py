"""A trained grasping policy. With wrist guidance and closed-loop motion synthesis it is the paper's own method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from dgrasp.config.sections import MotionConfig
from dgrasp.files.typed import typed
from dgrasp.methods.method import Method
from dgrasp.types import Array

if TYPE_CHECKING:
    from dgrasp.rl.networks import Policy


class PolicyMethod(Method):
    """A trained policy that acts without exploration noise from the start of the approach (paper, section 4.4).

    cfg, cfg_keys: the config and the keys with which train.py trains such a policy. trained_on: the record of the data
    that it was trained on (`DataChoice.stamp`); None if it is unknown.
    """

    name = "policy"
    takes_policy = "must"
    cfg: ClassVar[str] = "cfg/dexycb.yaml"
    cfg_keys: ClassVar[tuple[str, ...]] = ()

    def __init__(self, policy: Policy, trained_on: Mapping[str, Any] | None = None) -> None:
        self.policy, self.trained_on = policy, trained_on

    @classmethod
    def train_command(cls) -> str:
        """The command line that trains such a policy."""
        return typed("train", ["--cfg", cls.cfg, *cls.cfg_keys])

    @classmethod
    def needs_grasp(cls, motion: MotionConfig) -> bool:
        """Whether its environments or the choice of its labels need the frozen policy `motion.policy`."""
        return False

    def differences(self, data: Mapping[str, Any]) -> list[str]:
        """The policy's own hand if it is another one; its training data if that alone is not the paper's."""
        on = self.trained_on
        if on is None:
            return []
        if on.get("hand") != data["hand"]:
            return [f"the policy was trained for the hand {_shown(on.get('hand'))}, not {_shown(data['hand'])}"]
        trained_like_the_paper = on.get("comparable_with_paper") and on.get("split", "train") == "train"
        if data["comparable_with_paper"] and not trained_like_the_paper:
            used = ", ".join(f"{key} {_shown(on[key])}" for key in ("labels", "inertia") if key in on)
            return [f"the policy was trained on other data than the paper's ({used})"]
        return []

    def act(self, observation: Array) -> Array:
        """Actions (N, A): the means of the policy."""
        return self.policy.act(observation)


def _shown(name: Any) -> str:
    """A name from a policy's file, which may hold anything, on one short line."""
    return " ".join(ascii(name).strip("'").split())[:60]
