"""A trained grasping policy. With wrist guidance and closed-loop motion synthesis it is the paper's own method."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from dgrasp.config.sections import MotionConfig
from dgrasp.files.typed import typed
from dgrasp.labels.splits import is_papers_split, named_objects
from dgrasp.methods.method import Method
from dgrasp.types import Array

if TYPE_CHECKING:
    from dgrasp.rl.networks import Policy


class PolicyMethod(Method):
    """A trained policy that acts without exploration noise from the start of the approach (paper, section 4.4).

    cfg, cfg_keys: the config and the keys with which train.py trains such a policy. trained_on: the record of the data
    that it was trained on (`DataChoice.stamp`); None if it is unknown. objects: `labels.objects` of its training; empty
    for all objects, or if they are unknown.
    """

    name = "policy"
    takes_policy = "must"
    cfg: ClassVar[str] = "cfg/dexycb.yaml"
    cfg_keys: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self, policy: Policy, trained_on: Mapping[str, Any] | None = None, objects: Collection[str] = ()
    ) -> None:
        self.policy, self.trained_on = policy, trained_on
        self._seen = named_objects(objects)

    @classmethod
    def train_command(cls) -> str:
        """The command line that trains such a policy."""
        return typed("train", ["--cfg", cls.cfg, *cls.cfg_keys])

    @classmethod
    def needs_grasp(cls, motion: MotionConfig) -> bool:
        """Whether its environments or the choice of its labels need the frozen policy `motion.policy`."""
        return False

    def differences(self, data: Mapping[str, Any], objects: Collection[str]) -> list[str]:
        """The policy's own hand if it is another one; its training data if that alone is not the paper's.

        The paper tests policies on objects that they were trained on, or on one of its own sets of left-out objects.
        """
        on = self.trained_on
        if on is not None and on.get("hand") != data["hand"]:
            return [f"the policy was trained for the hand {_shown(on.get('hand'))}, not {_shown(data['hand'])}"]
        if not data["comparable_with_paper"]:
            return []
        if on is not None and not (on.get("comparable_with_paper") and on.get("split", "train") == "train"):
            used = ", ".join(f"{key} {_shown(on[key])}" for key in ("labels", "inertia") if key in on)
            return [f"the policy was trained on other data than the paper's ({used})"]
        unseen = self.unseen(objects)
        if unseen and not is_papers_split(self._seen, objects):
            return [f"the policy was not trained on {', '.join(unseen)}, and the paper has no such test"]
        return []

    def unseen(self, objects: Collection[str]) -> list[str]:
        """Those of `objects` that training left out; none if it is unknown what it was trained on."""
        return [name for name in objects if self._seen and name not in self._seen]

    def act(self, observation: Array) -> Array:
        """Actions (N, A): the means of the policy."""
        return self.policy.act(observation)


def _shown(name: Any) -> str:
    """A name from a policy's file, which may hold anything, on one short line."""
    return " ".join(ascii(name).strip("'").split())[:60]
