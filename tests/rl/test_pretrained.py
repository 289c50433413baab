"""The shipped policy: trained on the shipped set, small, and better than PD control on labels not used in training."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dgrasp.cli import run_command
from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.files.paths import data_root
from dgrasp.request import PRETRAINED_FILE
from dgrasp.rl.run.weights import read_weights
from raisim_like.engines import default_engine


def test_it_was_trained_on_the_set_that_ships() -> None:
    """If the shipped hand or labels change, the policy must be trained again."""
    file = data_root() / PRETRAINED_FILE
    assert file.stat().st_size <= 5 * 2**20
    _, about = read_weights(file)
    stamp = resolve(load_config(None, ["data=free", "labels.split=train"])).stamp()
    # It was trained before results named the inertia, with the authors'.
    assert stamp.pop("inertia") == "true" and "inertia" not in about["data"]
    assert about["data"] == stamp and stamp["licence"] == "MIT" and stamp["n_objects"] == 20
    assert '"/' not in json.dumps(about), "a path of the machine that trained"


def test_it_holds_what_pd_control_drops(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Test labels of three objects, held for 1.5 s without a table."""
    objects = "labels.objects=[003_cracker_box, 008_pudding_box, 010_potted_meat_can]"
    words = ["--data", "free", "--split", "test", "--window", "1.5", objects, "labels.limit_per_object=2",
             "eval.interpenetration=false", "pool.kind=serial"]  # fmt: skip
    success = {}
    for name, method in (("gt_pd", ["--baseline", "gt_pd"]), ("policy", ["--run", "pretrained"])):
        file = tmp_path / f"{name}.json"
        assert run_command("test", [*method, *words, "--json", str(file)]) == 0
        result = json.loads(file.read_text())
        assert result["engine"] == default_engine()
        success[name] = result["mean_over_labels"]["success"]
    capsys.readouterr()
    assert success["policy"] >= 0.85 and success["policy"] > success["gt_pd"] + 0.2
