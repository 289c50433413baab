"""From labels of one object to ranked grasps: test them, rank them, and carry the object of those that hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.data import DataChoice
from dgrasp.errors import ConfigError
from dgrasp.eval.summary import Result, Row
from dgrasp.evaluation import evaluate_choice, evaluate_motion
from dgrasp.hand.model import HandModel
from dgrasp.methods import PolicyMethod
from dgrasp.methods.method import Method
from dgrasp.motion.targets import TargetSet
from dgrasp.pool import PoolSpec
from dgrasp.types import EpisodeRecord


@dataclass(frozen=True, eq=False)
class TestedGrasps:
    """The tested grasps of one object.

    result, records, spec: of the stability test, in the label file's order. order: places of the grasps, best first.
    motion: the result of the motion, if there was one. motions: place of a grasp that holds -> its row and record.
    """

    choice: DataChoice
    result: Result
    records: list[EpisodeRecord]
    spec: PoolSpec
    order: list[int]
    motion: Result | None = None
    motions: dict[int, tuple[Row, EpisodeRecord]] = field(default_factory=dict)

    @property
    def held(self) -> list[int]:
        """Places of the grasps that hold, best first."""
        return [i for i in self.order if self.result.per_label[i]["success"]]

    @property
    def carried(self) -> list[int]:
        """Places of the grasps whose object was carried to the end of the motion, best first."""
        return [i for i in self.held if i in self.motions and self.motions[i][0]["carried"]]

    def verdict(self) -> str:
        """How many grasps hold, and how many are carried, in words."""
        text = f"{len(self.held)} of {len(self.order)} grasps hold for {self.result.window_s:g} s"
        if self.motion is not None:
            text += f", {len(self.carried)} of {len(self.held)} carry the object to the end of the motion"
        return text


def ranking(rows: Sequence[Row]) -> list[int]:
    """Places of the rows, best first: held grasps before lost ones, each kind by SimDist, the smallest first."""
    return sorted(range(len(rows)), key=lambda i: (not rows[i]["success"],
                                                   rows[i].get("sim_dist_mm_per_step", np.inf), i))


def check_policy(method: Method, hand: HandModel, named: str) -> None:
    """Raise `ConfigError` for a policy that does not grasp, or that was trained for another hand.

    named: the policy as the user gave it.
    """
    if not isinstance(method, PolicyMethod) or method.task != "grasp":
        raise ConfigError(f"--policy {named}: a policy for task {method.task}; expected one that grasps (task grasp)")
    trained = (method.trained_on or {}).get("hand")
    if isinstance(trained, str) and trained != hand.id:
        raise ConfigError(f"--policy {named}: trained for the hand {trained!r:.60}, but --hand is {hand.id!r}; "
                          "expected a hand and a policy that belong together")
    if method.policy.action_size != hand.layout.n_dof:
        raise ConfigError(f"--policy {named}: {method.policy.action_size} actions, but the hand {hand.id!r} has "
                          f"{hand.layout.n_dof} degrees of freedom; expected a hand and a policy that belong together")


def try_grasps(method: Method, config: Config, choice: DataChoice) -> TestedGrasps:
    """Grasp from each of the chosen labels, which are of one object, and take the table away."""
    result, records, spec = evaluate_choice(method, config, choice)
    return TestedGrasps(choice, result, records, spec, ranking(result.per_label))


def carry(grasps: TestedGrasps, method: Method, config: Config, target: TargetSet) -> TestedGrasps:
    """The grasps with the motions to a target of those that hold, of which there is at least one."""
    places, of = sorted(grasps.held), grasps.choice.labels
    held = replace(grasps.choice, labels=replace(of, labels=[of.labels[i] for i in places]))
    # They have passed the stability test already.
    config = config.model_copy(update={"motion": config.motion.model_copy(update={"stable_alone": False})})
    result, records, _ = evaluate_motion(method, config, held, target)
    motions = dict(zip(places, zip(result.per_label, records, strict=True), strict=True))
    return replace(grasps, motion=result, motions=motions)
