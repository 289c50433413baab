"""Where tests find the authors' release, which is never part of the project."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
_CANDIDATES = (os.environ.get("DGRASP_DATA"), ROOT.parent / "shared" / "reference")


def reference_dir() -> Path | None:
    """The folder of the authors' release, or None where it is absent."""
    for candidate in _CANDIDATES:
        if candidate and (Path(candidate) / "labels" / "dexycb_train_labels.pkl").is_file():
            return Path(candidate)
    return None


def reference_or_skip() -> Path:
    """The folder of the authors' release; skips the test where it is absent."""
    found = reference_dir()
    if found is None:
        pytest.skip("the authors' release is not here (set DGRASP_DATA to its folder)")
    return found
