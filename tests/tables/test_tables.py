"""The paper's tables: what they take, filled with what is there, trained within a budget, never done twice."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from dgrasp import test as test_command
from dgrasp import train
from dgrasp.cli import run_command
from dgrasp.config import load_config
from dgrasp.rl import checkpoint
from dgrasp.tables import plan as plan_module
from dgrasp.tables.fill import Cells, needed
from dgrasp.tables.plan import NAMES, Line, Plan, plans
from dgrasp.tables.show import cells_of, header_of, remarks
from tests.cli.folder import make_folder

SHORT = ["env.episode_steps=6", "env.grasp_steps=3", "physics.substeps=1", "ppo.minibatches=1", "ppo.update_epochs=1",
         "eval.window_s=0.06", "eval.gif=false", "eval.interpenetration=false", "ppo.hidden=[8]", "ppo.epochs=1",
         "pool.kind=serial"]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_folder(tmp_path_factory.mktemp("data") / "free")


def _table(name: str, folder: Path, runs: Path, *words: str) -> list[dict[str, Any]]:
    command = ["--table", name, "--data", str(folder), "--runs", str(runs), *words, *SHORT]
    assert run_command("test", command) == 0
    content = json.loads((runs / f"{name}.json").read_text())
    assert content["schema"] == 1 and content["table"] == name
    rows: list[dict[str, Any]] = content["rows"]
    return rows


def test_the_papers_numbers_stand_in_every_row() -> None:
    grasp, motion, ablation, unseen, scope = plans("all")
    assert [*(plan.name for plan in (grasp, motion, ablation, unseen, scope)), "recipe"] == list(NAMES)
    assert all(set(plan.metrics) <= set(line.paper) for plan in plans("all") for line in plan.lines)
    first = {line.name: line.paper["success"] for line in grasp.lines if line.group == "dexycb train"}
    assert first == {"GT+PD": 0.31, "GT+IK": 0.39, "Ours": 0.7}
    assert [(line.name, line.paper["mpe_m"]) for line in motion.lines] == [
        ("Flat-RL", 0.55), ("Ours+static grasp", 0.45), ("Ours+learned policy", 0.3), ("Ours", 0.08)
    ]  # fmt: skip
    assert [line.paper["success"] for line in ablation.lines] == [0.0, 0.28, 0.47, 0.58, 0.89]
    assert all(len(line.trials) == 3 for line in ablation.lines)
    assert len(unseen.lines) == 18 and len(scope.lines) == 4 and len(scope.lines[0].trials) == 20


def test_each_training_is_needed_once_and_after_what_it_is_built_on() -> None:
    keys = [run.key for run in needed(plans("all"))]
    assert len(keys) == len(set(keys)) == 1 + 2 + 4 * 3 + 20 + 6
    assert keys.index("all_objects") < keys.index("learned_motion")


def test_each_ingredient_of_the_recipe_is_a_row() -> None:
    (plan,) = plans("recipe")
    runs = {line.name: trial.run for line in plan.lines for trial in line.trials if trial.run is not None}
    assert len(runs) == len(plan.lines) == len({run.key for run in runs.values()}) > 10
    base = load_config(train.find_config(Path("cfg/fast.yaml")), [])
    for name, run in runs.items():
        assert run.cfg is not None
        config = load_config(train.find_config(Path(run.cfg)), run.overrides)
        assert config.labels.objects == list(plan_module.RECIPE_OBJECTS)
        same = config.model_copy(update={"labels": base.labels}) == base
        assert same == (name == "cfg/fast.yaml"), name


def test_a_table_that_the_paper_lacks_shows_ours_alone() -> None:
    (plan,) = plans("recipe")
    cells = Cells(plan.lines[0], {"success": 0.75}, {"success": [0.7, 0.8]}, 36, seeds={1: {"success": 0.7}})
    assert header_of(plan) == ["labels", "method", "n", "success", "to label mm", "to label deg"]
    assert cells_of(plan, cells) == ["2 objects, train", "cfg/fast.yaml *", "36", "0.75 [0.70, 0.80]", "-", "-"]
    assert "2 objects, train, cfg/fast.yaml, success by seed: 1: 0.70" in remarks(plan, [cells])


def test_a_row_shows_ours_the_papers_and_their_difference() -> None:
    line = Line("train", "Ours", (), {"success": 0.7})
    plan = Plan("x", "X", ("success", "mpe_m"), (line,))
    cells = Cells(line, {"success": 0.75, "mpe_m": 0.0561}, {"success": [0.7, 0.8]}, 12, True)
    assert cells_of(plan, cells) == ["train", "Ours", "12", "0.75 [0.70, 0.80]", "0.70", "+0.05", "0.056", "", ""]
    assert len(header_of(plan)) == 9
    assert cells_of(plan, Cells(line)) == ["train", "Ours", "-", "-", "0.70", "", "-", "", ""]
    assert cells_of(plan, Cells(line, {"success": 0.5}, {}, 2))[1] == "Ours *"


def test_what_is_there_is_evaluated_once_and_the_rest_is_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = _table("grasp", folder, tmp_path / "t")
    baseline, _, ours = (row for row in rows if row["labels"] == "dexycb train")
    assert baseline["n"] == 2 and 0.0 <= baseline["values"]["success"] <= 1.0 and not baseline["comparable_with_paper"]
    assert ours["values"] == {} and ours["missing"][0].startswith("python train.py --cfg cfg/dexycb.yaml --run")
    out = capsys.readouterr().out
    assert "GT+PD *" in out and "not the paper's: not comparable" in out and "missing" in out
    assert "| dexycb train | GT+PD * | 2 |" in (tmp_path / "t" / "grasp.md").read_text()

    def refuse(*_: Any) -> None:
        raise AssertionError("evaluated again")

    monkeypatch.setattr(test_command, "evaluate_choice", refuse)
    assert _table("grasp", folder, tmp_path / "t")[0]["values"] == baseline["values"]


def test_a_budget_trains_what_is_missing_and_an_interruption_goes_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_module, "ABLATION_OBJECTS", ("004_sugar_box",))
    began, real = [], train.train

    def interrupted(run_dir: Path, *rest: Any, **words: Any) -> None:
        began.append(run_dir.name)
        if len(began) == 3:
            raise KeyboardInterrupt
        real(run_dir, *rest, **words)

    monkeypatch.setattr(train, "train", interrupted)
    command = ["--table", "ablation", "--data", str(folder), "--runs", str(tmp_path), "--budget", "10", *SHORT]
    assert run_command("test", command) == 130
    rows = _table("ablation", folder, tmp_path, "--budget", "10")
    # Two were trained before; the third, of which nothing was saved, and the others now.
    assert began[:2] == ["no_contact_reward_004_sugar_box", "no_goal_space_004_sugar_box"]
    assert sorted(began[2:]) == sorted(
        ["no_feature_layer_004_sugar_box"] * 2 + ["no_wrist_guidance_004_sugar_box", "object_004_sugar_box"]
    )
    assert [(row["n"], row["missing"]) for row in rows] == [(1, [])] * 5
    (note,) = rows[0]["notes"]
    assert "no_contact_reward_004_sugar_box: 1 epochs" in note and "env.reward.contact=0.0" in note
    assert checkpoint.saved(tmp_path / "dexycb_pybullet_seed1" / "object_004_sugar_box")


def test_seeds_are_trained_apart_and_averaged(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(plan_module, "ABLATION_OBJECTS", ("004_sugar_box",))
    rows = _table("ablation", folder, tmp_path, "--budget", "10", "--seeds", "3,5")
    assert [row["n"] for row in rows] == [2] * 5
    for row in rows:
        assert list(row["seeds"]) == ["3", "5"]
        for metric, value in row["values"].items():
            assert value == pytest.approx(sum(row["seeds"][seed][metric] for seed in ("3", "5")) / 2)
    weights = [checkpoint.latest(tmp_path / f"dexycb_pybullet_seed{k}" / "object_004_sugar_box") for k in (3, 5)]
    assert weights[0].read_bytes() != weights[1].read_bytes()
    assert "Ours, contact ratio by seed: 3: " in capsys.readouterr().out
    # What is not learned is the same for all seeds.
    baseline = _table("grasp", folder, tmp_path, "--seeds", "3,5")[0]
    assert (baseline["n"], baseline["seeds"]) == (2, {})


def test_a_table_takes_no_method(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command("test", ["--table", "grasp", "--baseline", "gt_pd", "--data", str(folder)]) == 2
    assert "leave --baseline" in capsys.readouterr().err
