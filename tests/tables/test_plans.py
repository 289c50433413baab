"""The paper's tables: their rows and the trainings that they need, and what a row shows."""

from __future__ import annotations

from pathlib import Path

from dgrasp.config.experiment import find_config, load_config
from dgrasp.tables import plan as plan_module
from dgrasp.tables.fill import Cells
from dgrasp.tables.plan import NAMES, Line, Plan, plans
from dgrasp.tables.show import cells_of, header_of, remarks
from dgrasp.tables.trainings import needed


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
    base = load_config(find_config(Path("cfg/fast.yaml")), [])
    for name, run in runs.items():
        assert run.cfg is not None
        config = load_config(find_config(Path(run.cfg)), run.overrides)
        assert config.labels.objects == list(plan_module.RECIPE_OBJECTS)
        labels = config.labels.model_copy(update={"objects": base.labels.objects})
        same = config.model_copy(update={"labels": labels}) == base
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
