"""The paper's baselines, one module each."""

from __future__ import annotations

from dgrasp.baselines.pd import PdBaseline

BASELINES = {PdBaseline.name: PdBaseline}
"""By the name that `--baseline` takes."""
