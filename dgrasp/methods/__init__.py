"""The methods that can be evaluated: trained policies and the paper's baselines, one module each.

To add a method, write a module with a subclass of `Method` and list the class in `_KINDS`. A baseline also lists its
name in `dgrasp.config.names`.
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
"""All methods, by name."""
TRAINED = {kind.task: kind for kind in METHODS.values() if issubclass(kind, PolicyMethod)}
"""The kinds of policies that train.py trains, by `env.task`."""


def method_of(saved: SavedPolicy) -> PolicyMethod:
    """A saved policy as the method for its task; `DataError` for an unknown task."""
    if saved.task not in TRAINED:
        raise DataError(f"a policy of task {saved.task!r:.60}; expected {', '.join(TRAINED)}")
    return TRAINED[saved.task](saved.policy, saved.data, saved.objects)


__all__ = [
    "BASELINES", "METHODS", "TRAINED", "FlatRl", "IkBaseline", "LearnedMotion", "Method", "PdBaseline", "PolicyMethod",
    "StaticGrasp", "method_of",
]  # fmt: skip
