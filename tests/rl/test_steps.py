"""Control steps of a run: their limit and their count, also with growing epochs and resumed runs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from dgrasp.config.experiment import load_config
from dgrasp.rl.collect import Actor, Trajectories
from dgrasp.rl.run.folder import PLAN_NAME
from dgrasp.rl.run.record import read_run
from dgrasp.rl.runner import Runner
from tests.rl.toy import ToyEnv, assert_same, last, rows_of, run, toy_config


def test_control_steps_are_limited(tmp_path: Path) -> None:
    # 10 steps an epoch in each of 8 environments.
    config = toy_config(epochs=9, max_steps=3 * 80 + 79)
    run(tmp_path / "a", config)
    assert last(tmp_path / "a").epoch == 3
    assert rows_of(tmp_path / "a")[-1]["control_steps"] == "240"
    run(tmp_path / "a", toy_config(epochs=9, max_steps=4 * 80), resume=True)
    assert last(tmp_path / "a").epoch == 4
    run(tmp_path / "b", toy_config(epochs=9, max_steps=1))
    assert last(tmp_path / "b").epoch == 1
    # `read_run` knows the number of epochs from the learner's plan or, if that is lost, from the config.
    for name, epochs in (("a", 4), ("b", 1)):
        assert read_run(tmp_path / name).epochs == epochs and read_run(tmp_path / name).complete
        (tmp_path / name / PLAN_NAME).unlink()
        (tmp_path / name / "data.json").write_text('{"n_labels": 8}')
        assert read_run(tmp_path / name).epochs == epochs


def test_control_steps_count_what_was_made_before_a_resume_with_other_epochs(tmp_path: Path) -> None:
    run(tmp_path, toy_config(epochs=2))
    # 14 instead of 10 steps in each of 8 environments: 160 + 2 * 112 of at most 400.
    config = toy_config(epochs=9, steps=14, max_steps=400)
    runner = run(tmp_path, config, resume=True)
    assert runner.last_epoch == 4
    assert [row["control_steps"] for row in rows_of(tmp_path)][-3:] == ["160", "272", "384"]
    # The run's files hold the config with which it was resumed, so a test of the run uses that config.
    assert load_config(tmp_path / "config.yaml") == config
    assert json.loads((tmp_path / "data.json").read_text()) == {"hand": "toy"}


def test_steps_that_were_lost_with_their_worker_do_not_count(tmp_path: Path) -> None:
    class Losing(ToyEnv):
        def collect(self, actor: Actor, epoch: int, steps: int, advance: Callable[[int], None]) -> Trajectories:
            made = super().collect(actor, epoch, steps, advance)
            made.valid[:3] = epoch != 2
            return made

    Runner(Losing(), toy_config(epochs=3), tmp_path, {"hand": "toy"}).learn()
    # Three of eight environments, in one epoch of 10 steps.
    assert [row["control_steps"] for row in rows_of(tmp_path)] == ["80", "130", "210"]
    Runner(ToyEnv(), toy_config(epochs=4), tmp_path, {"hand": "toy"}, resume=True).learn()
    assert rows_of(tmp_path)[-1]["control_steps"] == "290"


def test_epochs_that_grow_are_counted_as_they_are(tmp_path: Path) -> None:
    # Epochs of 2, 2, 4, 4 and all 8 labels, 10 control steps each.
    labels = {"per_epoch": 2, "doubles_every": 2}
    base = toy_config(epochs=5)
    config = base.model_copy(update={"labels": base.labels.model_copy(update=labels)})
    run(tmp_path / "a", config)
    assert [row["control_steps"] for row in rows_of(tmp_path / "a")] == ["20", "40", "80", "120", "200"]
    limited = config.model_copy(update={"ppo": config.ppo.model_copy(update={"max_steps": 199})})
    run(tmp_path / "b", limited)
    assert last(tmp_path / "b").epoch == 4
    run(tmp_path / "b", config, resume=True)
    assert [row["control_steps"] for row in rows_of(tmp_path / "b")] == ["20", "40", "80", "120", "200"]
    assert_same(last(tmp_path / "a"), last(tmp_path / "b"))
    # Episodes of 10 steps, then 15, then 20.
    longer = config.model_copy(update={"env": config.env.model_copy(update={"lengthens_by": 5})})
    run(tmp_path / "c", longer)
    assert [row["control_steps"] for row in rows_of(tmp_path / "c")] == ["20", "40", "100", "160", "320"]
    # Without a log, as in runs of older versions, the steps are counted from the config.
    (tmp_path / "b" / "progress.csv").unlink()
    assert Runner(ToyEnv(), config, tmp_path / "b", {"hand": "toy"}, None, True)._resumed_steps == 200
