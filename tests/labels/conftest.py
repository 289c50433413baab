"""What several tests of labels take."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.labels.mini_dexycb import MiniDexYcb, make_mini


@pytest.fixture
def mini(tmp_path: Path) -> MiniDexYcb:
    return make_mini(tmp_path / "dex")[0]
