"""The paper's baselines, one module each."""

from __future__ import annotations

from collections.abc import Callable

from dgrasp.errors import DataError
from dgrasp.methods.flat_rl import FlatRl
from dgrasp.methods.ik import IkBaseline
from dgrasp.methods.learned_motion import LearnedMotion
from dgrasp.methods.pd import PdBaseline
from dgrasp.methods.policy import Method, PolicyMethod
from dgrasp.methods.static_grasp import StaticGrasp
from dgrasp.rl.run.policies import SavedPolicy

BASELINES: dict[str, Callable[[], Method]] = {
    PdBaseline.name: PdBaseline, IkBaseline.name: IkBaseline, StaticGrasp.name: StaticGrasp,
}
"""By the name that `--baseline` takes."""

TRAINED_BASELINES: dict[str, type[FlatRl] | type[LearnedMotion]] = {
    FlatRl.name: FlatRl, LearnedMotion.name: LearnedMotion,
}
"""Those that `--baseline` takes with the run, or the checkpoint, of a policy of their own."""


def method_of(saved: SavedPolicy) -> Method:
    """A trained policy as what its task makes it."""
    kinds = {PolicyMethod.task: PolicyMethod, **{kind.task: kind for kind in TRAINED_BASELINES.values()}}
    if saved.task not in kinds:
        raise DataError(f"a policy of task {saved.task!r:.60}; expected {', '.join(kinds)}")
    return kinds[saved.task](saved.policy)
