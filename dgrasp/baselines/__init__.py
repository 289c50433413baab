"""The paper's baselines, one module each."""

from __future__ import annotations

from dgrasp.baselines.ik import IkBaseline
from dgrasp.baselines.pd import PdBaseline

BASELINES: dict[str, type[PdBaseline]] = {baseline.name: baseline for baseline in (PdBaseline, IkBaseline)}
"""By the name that `--baseline` takes."""
