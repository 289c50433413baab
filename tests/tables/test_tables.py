"""The paper's tables: filling from existing runs, training within a budget, no evaluation twice."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dgrasp import evaluation as evaluate
from dgrasp import training
from dgrasp.cli import run_command
from dgrasp.config.experiment import find_config, load_config
from dgrasp.rl.run import checkpoint
from dgrasp.rl.run.folder import write_description
from dgrasp.tables import plan as plan_module
from dgrasp.tables.fill import Found, fill
from dgrasp.tables.plan import plans
from dgrasp.tables.trainings import Trainings, needed
from raisim_like.engines import default_engine
from tests.commands.folder import make_folder

SHORT = ["env.episode_steps=6", "env.grasp_steps=3", "physics.substeps=1", "ppo.minibatches=1", "ppo.update_epochs=1",
         "eval.window_s=0.06", "eval.gif=false", "eval.interpenetration=false", "ppo.hidden=[8]", "ppo.epochs=1",
         "pool.kind=serial"]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_folder(tmp_path_factory.mktemp("data") / "free")


def _table(name: str, folder: Path, runs: Path, *words: str) -> list[dict[str, Any]]:
    command = ["--table", name, "--data", str(folder), "--runs", str(runs), *SHORT, *words]
    assert run_command("test", command) == 0
    content = json.loads((runs / f"{name}.json").read_text())
    assert content["schema"] == 1 and content["table"] == name
    rows: list[dict[str, Any]] = content["rows"]
    return rows


@pytest.mark.parametrize("table", ["grasp", "ablation"])
def test_a_table_without_data_is_refused(table: str, tmp_path: Path, capsys) -> None:
    """The rows of the ablation need trainings, which the table would list for data that does not exist."""
    assert run_command("test", ["--table", table, "--data", str(tmp_path / "no"), "--runs", str(tmp_path / "r")]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: data: no folder ") and shown.err.count("\n") == 1
    assert shown.out == "" and not (tmp_path / "r").exists()


def test_a_table_in_which_no_evaluation_was_possible_is_an_error(folder: Path, tmp_path: Path, capsys) -> None:
    """A table that only lacks trainings is none: it says how to train them."""
    words = ["--data", str(folder), "--runs", str(tmp_path), "hand=claw"]
    assert run_command("test", ["--table", "grasp", *words]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: --table grasp: no evaluation was possible; the first that failed is dexycb "
                                "train, GT+PD: hand: ")
    assert "missing (" in shown.out and (tmp_path / "grasp.json").is_file()
    assert run_command("test", ["--table", "ablation", *words[:-1]]) == 0
    assert "missing (" in capsys.readouterr().out


def test_what_is_there_is_evaluated_once_and_the_rest_is_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = _table("grasp", folder, tmp_path / "t")
    baseline, _, ours = (row for row in rows if row["labels"] == "dexycb train")
    assert baseline["n"] == 2 and 0.0 <= baseline["values"]["success"] <= 1.0 and not baseline["comparable_with_paper"]
    assert ours["values"] == {} and ours["missing"][0].startswith("python train.py --cfg cfg/dexycb.yaml --run")
    out = capsys.readouterr().out
    assert "GT+PD *" in out and "missing" in out
    # Why the row is marked stands above the table.
    above = out.split("GT+PD *")[0]
    assert "not the paper's: not comparable" in above and "the hand is free" in above
    assert baseline["paper"] is None and ours["paper"]["success"] > 0.0
    assert "| dexycb train | GT+PD * | 2 |" in (tmp_path / "t" / "grasp.md").read_text()

    def refuse(*_: Any) -> None:
        raise AssertionError("evaluated again")

    monkeypatch.setattr(evaluate, "evaluate_choice", refuse)
    assert _table("grasp", folder, tmp_path / "t")[0]["values"] == baseline["values"]


def test_a_budget_trains_what_is_missing_and_an_interruption_goes_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_module, "ABLATION_OBJECTS", ("004_sugar_box",))
    began, real = [], training.train

    def interrupted(run_dir: Path, *rest: Any, **words: Any) -> None:
        began.append(run_dir.name)
        if len(began) == 3:
            raise KeyboardInterrupt
        real(run_dir, *rest, **words)

    monkeypatch.setattr(training, "train", interrupted)
    command = ["--table", "ablation", "--data", str(folder), "--runs", str(tmp_path), "--budget", "10", *SHORT]
    assert run_command("test", command) == 130
    rows = _table("ablation", folder, tmp_path, "--budget", "10")
    # Two runs were trained by the first command. The third saved nothing, so the second command trains it and the rest.
    assert began[:2] == ["no_contact_reward_004_sugar_box", "no_goal_space_004_sugar_box"]
    assert sorted(began[2:]) == sorted(
        ["no_feature_layer_004_sugar_box"] * 2 + ["no_wrist_guidance_004_sugar_box", "object_004_sugar_box"]
    )
    assert [(row["n"], row["missing"]) for row in rows] == [(1, [])] * 5
    note, changed = rows[0]["notes"]
    assert changed.startswith("evaluated with ") and "eval.window_s=0.06" in changed and "labels" not in changed
    assert "no_contact_reward_004_sugar_box: 1 epochs" in note and "env.episode_steps=6" in note
    # The keys that define a row are not reported as differences.
    assert "env.reward" not in note and "labels" not in note
    assert checkpoint.saved(tmp_path / f"dexycb_{default_engine()}_seed1" / "object_004_sugar_box")


def test_seeds_are_trained_apart_and_averaged(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(plan_module, "ABLATION_OBJECTS", ("004_sugar_box",))
    monkeypatch.setattr(plan_module, "_ABLATIONS", {"ours": ("Ours", ())})
    rows = _table("ablation", folder, tmp_path, "--budget", "10", "--seeds", "3,5")
    # One label with two seeds counts as one label.
    assert [row["n"] for row in rows] == [1]
    for row in rows:
        assert list(row["seeds"]) == ["3", "5"]
        for metric, value in row["values"].items():
            assert value == pytest.approx(sum(row["seeds"][seed][metric] for seed in ("3", "5")) / 2)
    folders = [tmp_path / f"dexycb_{default_engine()}_seed{k}" / "object_004_sugar_box" for k in (3, 5)]
    weights = [checkpoint.latest(folder) for folder in folders]
    assert weights[0].read_bytes() != weights[1].read_bytes()
    assert "Ours, contact ratio by seed: 3: " in capsys.readouterr().out
    # A method without training is evaluated once for all seeds.
    baseline = _table("grasp", folder, tmp_path, "--seeds", "3,5")[0]
    assert (baseline["n"], baseline["seeds"]) == (2, {})
    assert baseline["evaluated"][0].startswith(f"{default_engine()}, window 0.06 s, true inertia, version ")


@pytest.mark.parametrize("words", [
    ["--baseline", "gt_pd"], ["--split", "test"], ["--labels", "dexycb"], ["--objects", "004_sugar_box"],
    ["--json", "x.json"], ["--report", "x.html"], ["--records", "x"], ["--gif", "x.gif"], ["--motion", "near"],
    ["--shapes"],
])  # fmt: skip
def test_a_table_refuses_what_it_has_no_use_for(
    words: list[str], folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = tmp_path / "t"
    assert run_command("test", ["--table", "grasp", "--data", str(folder), "--runs", str(runs), *words]) == 2
    said = capsys.readouterr().err
    assert f"leave out {words[0]}" in said and "labels.objects" in said and not runs.exists()


def test_all_that_is_refused_is_named_at_once(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command("test", ["--table", "grasp", "--json", "x.json", "--split", "test", "--data", str(folder)]) == 2
    assert "leave out --split, --json" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--budget", "5"], ["--seeds", "1,2"], ["--runs", "x"]])
def test_what_is_of_tables_needs_one(words: list[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command("test", ["--baseline", "gt_pd", "--data", str(folder), *words, *SHORT]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {words[0]}: ") and "--table grasp" in said


def test_a_key_narrows_a_table_to_objects(folder: Path, tmp_path: Path) -> None:
    rows = _table("grasp", folder, tmp_path, "labels.objects=[004_sugar_box]")
    assert [row["n"] for row in rows if row["method"] == "GT+PD" and row["labels"] == "dexycb train"] == [1]


def test_a_training_on_other_data_is_neither_evaluated_nor_resumed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_module, "ABLATION_OBJECTS", ("004_sugar_box",))
    monkeypatch.setattr(plan_module, "_ABLATIONS", {"ours": ("Ours", ())})
    runs, other = tmp_path / "runs", make_folder(tmp_path / "other")
    with open(other / "hand" / "free_hand.urdf", "a", encoding="utf-8") as stream:
        stream.write("<!-- another hand -->\n")
    # The budget never suffices, so there is always more to train.
    endless = "ppo.epochs=1000000"
    (made,) = _table("ablation", folder, runs, "--budget", "0.001", endless)
    assert made["n"] == 1

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("resumed on other data")

    with monkeypatch.context() as patch:
        patch.setattr(training, "train", refuse)
        (row,) = _table("ablation", other, runs, "--budget", "10", endless)
    assert (row["values"], row["comparable_with_paper"], row["commands"]) == ({}, False, [])
    (reason,) = row["missing"]
    assert "object_004_sugar_box was trained on other data" in reason and "differs in hand_sha256)" in reason
    assert "--runs" in reason
    assert _table("ablation", folder, runs, endless)[0]["values"] == made["values"]


def test_data_that_is_not_there_leaves_the_row_without_ours(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_module, "ABLATION_OBJECTS", ("004_sugar_box",))
    monkeypatch.setattr(plan_module, "_ABLATIONS", {"ours": ("Ours", ())})
    _table("ablation", folder, tmp_path / "runs", "--budget", "10")
    other = make_folder(tmp_path / "other")
    (other / "labels" / "free_train.npz").unlink()
    (row,) = _table("ablation", other, tmp_path / "runs", "--budget", "10")
    assert row["values"] == {} and "cannot tell whether" in row["missing"][0] and "no train split" in row["missing"][0]


def test_a_learned_motion_keeps_the_grasps_that_it_was_built_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_module, "MOTION_OBJECTS", ("004_sugar_box", "005_tomato_soup_can"))
    (plan,) = plans("motion")
    learned = replace(plan, lines=tuple(line for line in plan.lines if line.name == "Ours+learned policy"))
    monkeypatch.setitem(plan_module._PLANS, "motion", lambda: learned)
    words = ["motion.stable_alone=false", "motion.steps=3", "checkpoint.keep=1"]
    (row,) = _table("motion", folder, tmp_path, "--budget", "10", *words)
    assert (row["n"], row["missing"]) == (2, [])
    note, _ = row["notes"]
    assert "env.episode_steps=6" in note and "env.task" not in note and "labels" not in note
    trained = tmp_path / f"dexycb_{default_engine()}_seed1"
    first, own = checkpoint.latest(trained / "all_objects"), trained / "learned_motion" / "grasp.pt"
    assert own.read_bytes() == first.read_bytes()
    assert f"motion.policy={json.dumps(str(own))}" in row["commands"][0]

    # A run trained with train.py names the original file; the next table makes the copy.
    config = trained / "learned_motion" / "config.yaml"
    config.write_text(config.read_text().replace(str(own), str(first)))
    own.unlink()
    _table("motion", folder, tmp_path, *words)
    assert own.read_bytes() == first.read_bytes()

    # Further training of the grasping policy does not change the policy that the motion was trained with.
    assert run_command("train", ["--resume", str(trained / "all_objects"), "ppo.epochs=2"]) == 0
    assert not first.exists()
    shutil.rmtree(trained / "results")
    (again,) = _table("motion", folder, tmp_path, *words)
    assert (again["missing"], again["values"]) == ([], row["values"])


@pytest.mark.parametrize(("motion", "comparable"), [(None, True), ("easy", True), ("near", False), ("x.csv", False)])
def test_motions_to_other_targets_than_the_papers_do_not_compare(motion: str | None, comparable: bool) -> None:
    (plan,) = plans("motion")
    result = {"method": "policy", "engine": "pybullet", "window_s": 5.0, "seed": 1,
              "commit": "0123456789", "data": {"comparable_with_paper": True}, "cost": {}}  # fmt: skip
    if motion is not None:
        result["motion"] = {"targets": motion}
    rows: list[Any] = [{"object": "004_sugar_box", "index": 0, "mpe_m": 0.1, "geodesic_rad": 0.5}]

    class Given:
        def find(self, *_: Any) -> Found:
            return Found(1, rows, [result], places=[0])

    seeds: Any = [Given()]
    assert [cells.comparable for cells in fill(plan, seeds)] == [comparable] * 4


def test_a_training_as_its_row_asks_for_differs_in_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan_module, "ABLATION_OBJECTS", ("004_sugar_box",))
    trainings = Trainings(tmp_path, Path("cfg/dexycb.yaml"), [], None, print)
    chosen = {run.key: run for run in needed([*plans("grasp"), *plans("motion"), *plans("ablation"), *plans("recipe")])}
    for run in chosen.values():
        recipe = find_config(Path(run.cfg or "cfg/dexycb.yaml"))
        config = load_config(recipe, [*run.overrides, "ppo.max_minutes=1.0"])
        write_description(trainings.run_dir(run), config, {})
        assert trainings.about(run) == [f"{run.key}: 0 of {config.ppo.epochs} epochs, 0 control steps, 0.00 core-hours"]
    for key, said in {"all_objects": "the paper's training in ", "recipe_long": "cfg/fast.yaml in "}.items():
        folder = trainings.run_dir(chosen[key])
        config = load_config(folder / "config.yaml", ["labels.objects=[005_tomato_soup_can]", "env.grasp_steps=2"])
        write_description(folder, config, {})
        (note,) = trainings.about(chosen[key])
        keys = "labels.objects=['005_tomato_soup_can'], env.grasp_steps=2"
        assert note.endswith(f"; differs from {said}{keys}; differs from this command: it was trained with {keys}")
    # A run on the authors' release that names their inertia has what null means there; on the free set it has not.
    run = chosen["all_objects"]
    config = load_config(find_config(Path(run.cfg or "cfg/dexycb.yaml")), ["physics.official_compat=true"])
    for kind, differs in (("release", False), ("free", True)):
        write_description(trainings.run_dir(run), config, {"kind": kind})
        assert ("official_compat=True" in trainings.about(run)[0]) == differs
