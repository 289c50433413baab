"""The examples run, and what they print is true."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from dgrasp.hand.free.hand import URDF_PATH
from raisim_like import read_urdf
from raisim_like.engines import ENGINES
from tests.imports import ROOT


@pytest.mark.parametrize("engine", ENGINES)
def test_the_dropped_hand_falls_and_lies_on_the_table_with_its_weight(engine: str) -> None:
    pytest.importorskip(engine)
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / "drop_hand.py"), engine], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = re.findall(r"([\d.]+) s: palm +(\d+) mm above the table, pressing with +([\d.]+) N", done.stdout)
    times, heights, forces = (list(map(float, column)) for column in zip(*rows, strict=True))
    assert times == pytest.approx([0.1 * (i + 1) for i in range(8)])
    assert heights[0] > heights[2] > heights[-1] and forces[0] == 0.0
    assert abs(heights[-1] - heights[-2]) <= 1
    assert forces[-1] == pytest.approx(9.81 * read_urdf(URDF_PATH).mass, abs=0.1)
