"""The paper's baselines, one module each."""

from __future__ import annotations

from collections.abc import Callable

from dgrasp.baselines.ik import IkBaseline
from dgrasp.baselines.pd import PdBaseline
from dgrasp.baselines.static_grasp import StaticGrasp
from dgrasp.eval.method import Method

BASELINES: dict[str, Callable[[], Method]] = {
    PdBaseline.name: PdBaseline, IkBaseline.name: IkBaseline, StaticGrasp.name: StaticGrasp,
}
"""By the name that `--baseline` takes."""
