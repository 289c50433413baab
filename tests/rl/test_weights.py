"""Shared policies: the same actions as the checkpoint's, no path of a machine, and only weights are read."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from dgrasp import request
from dgrasp.cli import run_command
from dgrasp.config.experiment import Config
from dgrasp.errors import DataError
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.run.checkpoint import Checkpoint, policy_of
from dgrasp.rl.run.policies import read_policy
from dgrasp.rl.run.weights import read_weights, write_weights
from tests.commands.folder import make_folder
from tests.labels.test_fuzz import mutate
from tests.tables.test_tables import SHORT


def checkpoint() -> Checkpoint:
    model = ActorCritic(7, 3, [5, 4], 1.0, torch.Generator().manual_seed(2), actor_size=6)
    config = Config().model_dump(mode="json") | {"data": "/home/somebody/data", "hand": "/home/somebody/hand.urdf"}
    return Checkpoint(12, model.state_dict(), {}, 1e-3, model.architecture(), config, {"kind": "free"}, "0.1", 0.5)


def test_the_same_actions_and_no_paths(tmp_path: Path) -> None:
    path, made = tmp_path / "a.safetensors", checkpoint()
    size = write_weights(path, made)
    # 6x5 + 5, 5x4 + 4, 4x3 + 3 numbers of four bytes, and text; no critic.
    assert path.stat().st_size == size and 4 * (35 + 24 + 15) < size < 8000
    observation = np.random.default_rng(0).normal(size=(9, 7)).astype(np.float32)
    policy, about = read_weights(path)
    assert np.array_equal(policy.act(observation), policy_of(made).act(observation))
    assert about["epoch"] == 12 and about["data"] == {"kind": "free"}
    assert b"somebody" not in path.read_bytes()
    saved = read_policy(path)
    assert saved.task == "grasp" and saved.env["features"] == "phi"
    assert np.array_equal(saved.policy.act(observation), policy.act(observation))


@pytest.mark.parametrize(
    ("meta", "tensors", "message"),
    [
        (None, {"x": torch.ones(2)}, "not a policy"),
        ({"format": "dgrasp-policy", "schema": "9"}, {}, "not a policy"),
        ({"about": "{"}, {}, "damaged"),
        ({"about": "[]"}, {}, "does not describe"),
        ({"about": '{"architecture": {"hidden": [-1]}, "config": {}}'}, {}, "does not describe"),
        ({}, {"actor.0.weight": torch.ones(5, 5)}, "do not match layers"),
        ({}, {"actor.4.bias": torch.full((3,), torch.nan)}, "finite"),
        ({}, {"actor.4.bias": torch.ones(3, dtype=torch.float64)}, "finite"),
    ],
)
def test_other_content_is_refused(tmp_path: Path, meta: dict[str, str] | None, tensors: Any, message: str) -> None:
    made = checkpoint()
    weights = {name: value for name, value in made.model.items() if name.startswith("actor.")} | tensors
    about = json.dumps({"architecture": made.architecture, "config": {}})
    whole = None if meta is None else {"format": "dgrasp-policy", "schema": "1", "about": about} | meta
    path = tmp_path / "a.safetensors"
    save_file(weights, path, whole)
    with pytest.raises(DataError, match=message) as caught:
        read_policy(path)
    assert str(path) in str(caught.value)


def test_damaged_files_are_refused_or_sound(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    write_weights(path, checkpoint())
    raw, rng, refused = path.read_bytes(), np.random.default_rng(3), 0
    for _ in range(300):
        path.write_bytes(mutate(raw, rng))
        try:
            policy, _ = read_weights(path)
        except DataError as error:
            refused += 1
            assert str(path) in str(error) and len(str(error)) < 2000
        else:
            assert np.isfinite(policy.act(np.ones((1, policy.observation_size), np.float32))).all()
    assert refused > 150
    with pytest.raises(DataError, match="cannot read"):
        read_weights(tmp_path / "none.safetensors")


def test_from_a_run_to_a_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A policy comes with its own features; a config with other features is refused."""
    data = make_folder(tmp_path / "free")
    words = ["--data", str(data), *SHORT]
    run, weights = tmp_path / "run", tmp_path / "mine.safetensors"
    training = ["--cfg", "cfg/dexycb.yaml", "--run", str(run), *words, "env.scaled_features=true"]
    assert run_command("train", training) == 0
    assert run_command("publish", [str(run), "--out", str(weights)]) == 0
    assert "MIT" in capsys.readouterr().out
    shipped = tmp_path / request.PRETRAINED_FILE
    shipped.parent.mkdir()
    shutil.copy(weights, shipped)
    monkeypatch.setattr(request, "data_root", lambda: tmp_path)
    results = []
    for source in (["--run", str(run)], ["--policy", str(weights)], ["--policy", str(run / "best.pt")],
                   ["--run", "pretrained"]):  # fmt: skip
        assert run_command("test", [*source, *words, "--json", str(tmp_path / "r.json")]) == 0
        results.append(json.loads((tmp_path / "r.json").read_text())["per_label"])
    assert results[1:] == results[:1] * 3
    shipped.unlink()
    assert run_command("test", ["--run", "pretrained"]) == 2
    capsys.readouterr()
    for other in (["--cfg", "cfg/dexycb.yaml"], ["env.scaled_features=false"]):
        assert run_command("test", ["--policy", str(weights), *words, *other]) == 2
        assert "env.scaled_features=True" in capsys.readouterr().err
    assert run_command("publish", [str(run), "--out", str(tmp_path / "a.pt")]) == 2
    assert "expected the name of a .safetensors file" in capsys.readouterr().err
