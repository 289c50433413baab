"""What a cell of a table counts, and when it cannot be compared with the paper."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from dgrasp.config.experiment import find_config, load_config
from dgrasp.request import Asked, config_of
from dgrasp.tables import fill as fill_module
from dgrasp.tables.fill import Cells
from dgrasp.tables.plan import plans
from dgrasp.tables.show import cells_of


def test_seeds_of_a_label_are_one_label() -> None:
    seeds: list[list[Any]] = [
        [(0, {"object": "a", "index": i, "success": i < 2, "sim_dist_mm_per_step": 1.0}) for i in range(4)],
        [(0, {"object": "a", "index": i, "success": i < 1}) for i in range(4)],
    ]
    rows = fill_module._over_seeds(seeds)
    assert [row["success"] for row in rows] == [1.0, 0.5, 0.0, 0.0]
    assert rows[0] == {"object": "a", "index": 0, "success": 1.0, "sim_dist_mm_per_step": 1.0}
    # The same outcomes from three seeds give the same interval as from one.
    one, three = (fill_module._summary(fill_module._over_seeds([seeds[0]] * k),
                                       {"method": "policy", "engine": "e", "window_s": 5.0, "seed": 1, "data": {},
                                        "cost": {}}).intervals["mean_over_objects"]["success"] for k in (1, 3))
    assert one == three
    # Two motions of one label stay two rows.
    twice: list[Any] = [(0, {"object": "a", "index": 0, "mpe_m": 0.1}), (0, {"object": "a", "index": 0, "mpe_m": 0.3})]
    assert [row["mpe_m"] for row in fill_module._over_seeds([twice, twice])] == [0.1, 0.3]
    # Labels of different evaluations, such as two splits, stay apart even if a seed lacks the first evaluation.
    both: list[Any] = [(k, {"object": "a", "index": 0, "success": k == 0}) for k in (0, 1)]
    assert [row["success"] for row in fill_module._over_seeds([both, both[1:]])] == [1.0, 0.0]


def test_an_evaluation_that_is_narrowed_does_not_compare() -> None:
    (plan,) = plans("grasp")
    trial = plan.lines[0].trials[0]
    config = load_config(find_config(Path("cfg/dexycb.yaml")), [*trial.overrides, "labels.per_epoch=4"])
    assert fill_module._changed(trial, config, False) == []
    words = ["labels.limit_per_object=1", "eval.window_s=3.87", "physics.friction=0.5", "ppo.gamma=0.5"]
    narrowed = load_config(find_config(Path("cfg/dexycb.yaml")), [*trial.overrides, *words])
    assert fill_module._changed(trial, narrowed, False) == [
        "labels.limit_per_object=1", "physics.friction=0.5", "eval.window_s=3.87"
    ]  # fmt: skip
    # The paper's number covers all objects and labels.
    cells = Cells(plan.lines[0], {"success": 1.0}, {}, 1, comparable=False)
    assert cells_of(plan, cells)[:6] == ["dexycb train", "GT+PD *", "1", "1.00", "", ""]


def test_what_every_row_asks_for_is_no_change() -> None:
    for plan in [*plans("all"), *plans("recipe")]:
        for trial in (trial for line in plan.lines for trial in line.trials):
            cfg = "cfg/dexycb.yaml" if trial.run is None else trial.run.cfg or "cfg/dexycb.yaml"
            asked = Asked(cfg=Path(cfg), overrides=trial.overrides)
            config = config_of(asked)
            assert fill_module._changed(trial, config, plan.name == "motion") == [], (plan.name, trial)
            moved = config_of(replace(asked, overrides=[*trial.overrides, "motion.steps=7"]))
            expected = ["motion.steps=7"] if plan.name == "motion" else []
            assert fill_module._changed(trial, moved, plan.name == "motion") == expected
