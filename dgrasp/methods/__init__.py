"""What can be evaluated: trained policies and the paper's baselines, one module each.

A new method is one module with a class like those here, and its place in `METHODS`; a baseline has its name in
`dgrasp.config.names` too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dgrasp.config.names import BASELINES
from dgrasp.errors import DataError
from dgrasp.methods.flat_rl import FlatRl
from dgrasp.methods.ik import IkBaseline
from dgrasp.methods.learned_motion import LearnedMotion
from dgrasp.methods.method import Method
from dgrasp.methods.pd import PdBaseline
from dgrasp.methods.policy import PolicyMethod
from dgrasp.methods.static_grasp import StaticGrasp

if TYPE_CHECKING:
    from dgrasp.rl.run.policies import SavedPolicy

_KINDS: tuple[type[Method], ...] = (PolicyMethod, PdBaseline, IkBaseline, StaticGrasp, FlatRl, LearnedMotion)
METHODS: dict[str, type[Method]] = {kind.name: kind for kind in _KINDS}
"""By name."""
TRAINED = {kind.task: kind for kind in METHODS.values() if issubclass(kind, PolicyMethod)}
"""The kinds of policies that train.py makes, by their `env.task`."""


def method_of(saved: SavedPolicy) -> PolicyMethod:
    """A trained policy as what its task makes it."""
    if saved.task not in TRAINED:
        raise DataError(f"a policy of task {saved.task!r:.60}; expected {', '.join(TRAINED)}")
    return TRAINED[saved.task](saved.policy)


__all__ = [
    "BASELINES", "METHODS", "TRAINED", "FlatRl", "IkBaseline", "LearnedMotion", "Method", "PdBaseline", "PolicyMethod",
    "StaticGrasp", "method_of",
]  # fmt: skip
