"""A shortened `dgrasp demo`: both methods, the motion, a training, and their output files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from dgrasp.cli import run_command
from dgrasp.commands import demo
from dgrasp.config.experiment import load_config
from dgrasp.files.paths import package_file
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.run.checkpoint import Checkpoint
from dgrasp.rl.run.weights import write_weights
from tests.tables.test_tables import SHORT


def test_the_demo_from_end_to_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    model = ActorCritic(281, 51, [4], 1.0, torch.Generator().manual_seed(0), actor_size=279)
    config = load_config(package_file("cfg/fast.yaml")).model_dump(mode="json")
    weights = tmp_path / "p.safetensors"
    write_weights(weights, Checkpoint(1, model.state_dict(), {}, 1e-3, model.architecture(), config, {}, "0", None))
    monkeypatch.setattr(demo, "PRETRAINED_FILE", weights)
    short = [*SHORT, "motion.steps=3", "env.hold.first_step=2", "env.hold.last_step=4", "ppo.max_minutes=1"]
    monkeypatch.chdir(tmp_path)
    run = Path("runs/demo_1")
    assert run_command("demo", short) == 0
    shown = capsys.readouterr().out
    assert "20 labels that no policy was trained on" in shown and "mean over objects" in shown
    assert "carrying six objects" in shown and "trained from scratch on 004_sugar_box" in shown
    assert f"dgrasp train --resume {run}" in shown
    for name, count in (("gt_pd", 20), ("policy", 20), ("motion", 6)):
        result = json.loads((run / f"{name}.json").read_text())
        assert len(result["per_label"]) == count and result["data"]["split"] == "test"
        assert "replay-data" in (run / f"{name}.html").read_text()
    assert (run / "grasps.gif").read_bytes().startswith(b"GIF89a")
    assert (run / "checkpoints").is_dir()
    # An existing folder is not overwritten.
    assert run_command("demo", ["--run", str(run), *short]) == 2
