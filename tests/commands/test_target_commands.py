"""The trained baselines of motion synthesis as users type them, on two labels and episodes of a few steps."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from dgrasp.cli import run_command
from dgrasp.rl.run.checkpoint import latest
from tests.commands.folder import make_folder

SHORT = ["env.episode_steps=6", "env.grasp_steps=3", "eval.window_s=0.1", "motion.steps=3", "pool.kind=serial",
         "physics.substeps=2", "ppo.hidden=[8]", "eval.every=2", "eval.gif=false", "labels.objects=[]"]  # fmt: skip
EPOCHS = "ppo.epochs=2"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_folder(tmp_path_factory.mktemp("data") / "set")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def grasp(folder, root):
    words = ["--cfg", "cfg/dexycb.yaml",
             "--data", str(folder), "--run", str(root / "grasp"), *SHORT, "ppo.epochs=1", "eval.every=9"]
    assert run_command("train", words) == 0
    return root / "grasp"


@pytest.fixture(scope="module")
def flat(folder, root):
    words = ["--cfg", "cfg/flat_rl.yaml", "--data", str(folder), "--run", str(root / "flat"), *SHORT, EPOCHS]
    assert run_command("train", words) == 0
    return root / "flat"


@pytest.fixture(scope="module")
def learned(folder, root, grasp):
    words = ["--cfg", "cfg/learned_motion.yaml", "--data", str(folder), "--run", str(root / "learned"), *SHORT, EPOCHS]
    words += [f"motion.policy={latest(grasp)}", "motion.stable_alone=false"]
    assert run_command("train", words) == 0
    return root / "learned"


def rows_of(run):
    with open(run / "progress.csv", encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.parametrize(("which", "steps"), [("flat", 6), ("learned", 3)])
def test_two_epochs_are_learned_from_and_measured(which, steps, request):
    rows = rows_of(request.getfixturevalue(which))
    assert [row["control_steps"] for row in rows] == ["0", str(2 * steps), str(4 * steps)]
    for row in rows[1:]:
        # 2 alpha_x per m and step; the targets are some decimetres away.
        assert -2.0 * steps < float(row["target_position"]) < 0.0 and float(row["target_rotation"]) < 0.0
        assert np.isfinite([float(row["return"]), float(row["kl"]), float(row["value_loss"])]).all()
    assert ("contact" in rows[0]) == (which == "flat")
    assert 0.0 < float(rows[2]["mpe_m"]) < 1.0 and float(rows[2]["geodesic_rad"]) > 0.0 and rows[2]["carried"]


@pytest.mark.parametrize(("which", "name"), [("flat", "flat_rl"), ("learned", "learned_motion")])
def test_each_baseline_is_one_line(which, name, request, tmp_path):
    run, file = request.getfixturevalue(which), tmp_path / "out.json"
    assert run_command("test", ["--baseline", name, "--run", str(run), "--json", str(file)]) == 0
    result = json.loads(file.read_text())
    assert result["method"] == name and result["n_labels"] == 2 and result["motion"]["targets"] == "near"
    # Both methods have the steps of the grasp and of the motion.
    assert result["cost"]["control_steps"] == 2 * (3 + 3)
    assert set(result["per_label"][0]) >= {"target", "mpe_m", "geodesic_rad", "carried"}
    assert result["motion"]["sigma"] == {"position": 0.01, "rotation": 0.01}
    # The run alone identifies the method, without --baseline.
    again = tmp_path / "again.json"
    assert run_command("test", ["--run", str(run), "--json", str(again)]) == 0
    assert json.loads(again.read_text())["per_label"] == result["per_label"]


def test_only_grasps_that_are_stable_are_trained_on(folder, root, grasp, monkeypatch, capsys):
    from dgrasp.eval import motion

    verdict = iter([False, True])
    monkeypatch.setattr(motion.metrics, "success", lambda record, window_s: next(verdict))
    run = root / "stable"
    words = ["--cfg", "cfg/flat_rl.yaml", "--data", str(folder), "--run", str(run), *SHORT, "ppo.epochs=1",
             "ppo.minibatches=2", f"motion.policy={latest(grasp)}", "motion.stable_alone=true"]  # fmt: skip
    assert run_command("train", words) == 0
    assert "1 of 2 grasps of motion.policy are stable" in capsys.readouterr().out
    assert rows_of(run)[1]["control_steps"] == "6"


def test_wrong_use_is_one_message(folder, root, grasp, flat, capsys):
    def said(*words):
        assert run_command(words[0], [str(word) for word in words[1:]]) == 2
        message = capsys.readouterr().err
        assert message.startswith("error: ") and "Traceback" not in message
        return message

    missing = " ".join(said("test", "--baseline", "flat_rl").split())
    assert "train one: python train.py --cfg cfg/flat_rl.yaml" in missing
    assert "one of task grasp" in said("test", "--baseline", "flat_rl", "--run", grasp)
    assert "one of task flat" in said("test", "--baseline", "learned_motion", "--run", flat)
    assert "is for task flat" in said("test", "--policy", latest(flat), "--cfg", "cfg/dexycb.yaml")
    assert "is for task grasp" in said("test", "--run", grasp, "--cfg", flat / "config.yaml")
    hold = said("test", "--baseline", "static_grasp", "--run", flat)
    assert "makes no grasp to hold" in hold

    words = ["train", "--cfg", "cfg/learned_motion.yaml", "--data", folder, "--run", root / "none", *SHORT]
    assert "motion.policy: expected the checkpoint of a grasping policy" in said(*words)
    assert "is a policy of task flat" in said(*words, f"motion.policy={latest(flat)}")
    assert "cannot read" in said(*words, "motion.policy=no/such.pt")
    frozen = f"motion.policy={latest(grasp)}"
    assert "env.scaled_features is False there, True here" in said(*words, frozen, "env.scaled_features=true")
    assert not (root / "none").exists()
