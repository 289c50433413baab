"""Training on a toy: it learns, repeats to the bit, and can be stopped and resumed."""

from __future__ import annotations

import errno
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from dgrasp.errors import ConfigError, DataError
from dgrasp.pool.base import PoolError
from dgrasp.rl.networks import Policy
from dgrasp.rl.run import checkpoint as checkpoints
from dgrasp.rl.runner import Interrupted, Runner, epoch_generator
from tests.rl.toy import ToyEnv, assert_same, last, rows_of, run, toy_config

TIMES = ("seconds", "core_hours", "steps_per_second", "update_share")
"""Columns of the log that differ from run to run."""


def _success(policy: Policy) -> dict[str, Any]:
    """A stand-in for the evaluation: how well one step goes from the origin to (1, -1)."""
    action = policy.act(np.array([[1.0, -1.0, 0.0, 0.0]], np.float32))[0]
    return {"success": float(np.exp(-np.abs(action - [1.0, -1.0]).sum())), "contact_ratio": 0.25}


def test_it_learns(tmp_path: Path) -> None:
    # Standing still costs about 2 dimensions * mean |target| 0.5 = 1 per step, 20 per epoch of 20 steps; a
    # good policy is at the target after the first of 7 to 10 steps of each episode.
    config = toy_config(epochs=30, steps=20, every=30, gamma=0.9, update_epochs=4, minibatches=4)
    run(tmp_path, config, num_envs=32, episode_steps=10)
    returns = [float(row["return"]) for row in rows_of(tmp_path)]
    assert np.mean(returns[-3:]) > 0.5 * np.mean(returns[:3]) and np.mean(returns[:3]) < -10.0


def test_a_seeded_run_repeats_to_the_bit(tmp_path: Path) -> None:
    torch.manual_seed(1)
    run(tmp_path / "a", toy_config(seed=3))
    torch.manual_seed(2)
    np.random.default_rng().random()
    run(tmp_path / "b", toy_config(seed=3))
    run(tmp_path / "c", toy_config(seed=4))
    assert_same(last(tmp_path / "a"), last(tmp_path / "b"))
    columns = [name for name in rows_of(tmp_path / "a")[0] if name not in TIMES]
    for a, b in zip(rows_of(tmp_path / "a"), rows_of(tmp_path / "b"), strict=True):
        assert [a[name] for name in columns] == [b[name] for name in columns]
    assert not torch.equal(last(tmp_path / "a").model["actor.0.weight"], last(tmp_path / "c").model["actor.0.weight"])


def test_resume_is_the_straight_run_to_the_bit(tmp_path: Path) -> None:
    run(tmp_path / "straight", toy_config(epochs=6), evaluate=_success)
    run(tmp_path / "parts", toy_config(epochs=4), evaluate=_success)
    assert last(tmp_path / "parts").epoch == 4
    runner = run(tmp_path / "parts", toy_config(epochs=6), resume=True, evaluate=_success)
    assert runner.env.resets == [5, 6]  # type: ignore[attr-defined]
    assert_same(last(tmp_path / "straight"), last(tmp_path / "parts"))
    assert [row["epoch"] for row in rows_of(tmp_path / "parts")] == ["0", "1", "2", "3", "4", "5", "6"]


def test_resume_half_way_drops_what_came_later(tmp_path: Path) -> None:
    run(tmp_path / "straight", toy_config(epochs=6))
    run(tmp_path / "parts", toy_config(epochs=5))
    for epoch in (4, 5):
        (tmp_path / "parts" / "checkpoints" / f"{epoch:06d}.pt").unlink()
    with open(tmp_path / "parts" / "progress.csv", "a") as stream:
        stream.write("6,7")  # a row that a crash cut off
    run(tmp_path / "parts", toy_config(epochs=6), resume=True)
    assert_same(last(tmp_path / "straight"), last(tmp_path / "parts"))
    assert [row["epoch"] for row in rows_of(tmp_path / "parts")] == ["1", "2", "3", "4", "5", "6"]


def test_resume_of_a_finished_run_changes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path, toy_config())
    before = checkpoints.latest(tmp_path).read_bytes()
    runner = run(tmp_path, toy_config(), resume=True)
    assert runner.env.resets == []  # type: ignore[attr-defined]
    assert checkpoints.latest(tmp_path).read_bytes() == before
    assert "raise ppo.epochs" in capsys.readouterr().err




@pytest.mark.parametrize(("limits", "expected"), [((1e-6, 1e-5), 1e-5), ((1e-2, 1e-1), 1e-2)])
def test_a_resumed_learning_rate_is_within_its_limits(
    tmp_path: Path, limits: tuple[float, float], expected: float
) -> None:
    run(tmp_path, toy_config(epochs=1))
    config = toy_config(min_learning_rate=limits[0], max_learning_rate=limits[1])
    assert Runner(ToyEnv(), config, tmp_path, {}, None, True).ppo.learning_rate == pytest.approx(expected)


def test_resume_tells_what_changed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path, toy_config(epochs=1))
    Runner(ToyEnv(), toy_config(epochs=2, gamma=0.5), tmp_path, {"hand": "other"}, None, True).learn()
    shown = capsys.readouterr().err
    assert "config differs from the checkpoint's in ppo.epochs, ppo.gamma" in shown
    assert "data differs from the checkpoint's in hand" in shown


def test_resume_with_a_fixed_learning_rate_takes_the_config_s(tmp_path: Path) -> None:
    fixed = {"adaptive_learning_rate": False}
    run(tmp_path, toy_config(epochs=1, **fixed))
    runner = Runner(ToyEnv(), toy_config(learning_rate=1e-4, **fixed), tmp_path, {}, None, True)
    assert runner.ppo.learning_rate == 1e-4


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interruption_leaves_the_last_completed_epoch(tmp_path: Path, number: signal.Signals) -> None:
    def interrupt(env: ToyEnv, epoch: int, step: int) -> None:
        if (epoch, step) == (3, 5):
            os.kill(os.getpid(), number)

    handlers = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    with pytest.raises(Interrupted, match=r"epoch 2 is saved in .*000002\.pt, continue with --resume") as caught:
        run(tmp_path / "parts", toy_config(every=100), on_step=interrupt)
    assert caught.value.checkpoint == checkpoints.latest(tmp_path / "parts") and caught.value.epoch == 2
    assert handlers == [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    run(tmp_path / "parts", toy_config(), resume=True)
    run(tmp_path / "straight", toy_config())
    assert_same(last(tmp_path / "parts"), last(tmp_path / "straight"))


def test_interruption_of_an_update_does_not_leak_into_the_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = toy_config(every=100)
    runner = Runner(ToyEnv(), config, tmp_path / "parts", {"hand": "toy"})
    update = runner.ppo.update

    def interrupted_update(*arguments: Any) -> dict[str, float]:
        statistics = update(*arguments)
        if runner.epoch == 1:  # in epoch 2, whose weights are already new
            raise KeyboardInterrupt
        return statistics

    monkeypatch.setattr(runner.ppo, "update", interrupted_update)
    with pytest.raises(Interrupted):
        runner.learn()
    run(tmp_path / "straight", toy_config(epochs=1))
    assert_same(last(tmp_path / "parts"), last(tmp_path / "straight"))


def test_interruption_before_the_first_epoch_is_usable_too(tmp_path: Path) -> None:
    def interrupt(policy: Policy) -> dict[str, Any]:
        raise KeyboardInterrupt

    with pytest.raises(Interrupted):
        run(tmp_path / "parts", toy_config(), evaluate=interrupt)
    assert last(tmp_path / "parts").epoch == 0
    run(tmp_path / "parts", toy_config(), resume=True, evaluate=_success)
    run(tmp_path / "straight", toy_config(), evaluate=_success)
    assert_same(last(tmp_path / "parts"), last(tmp_path / "straight"))
    assert [row["epoch"] for row in rows_of(tmp_path / "parts")] == ["0", "1", "2", "3", "4"]


def test_full_disk_is_one_error_and_keeps_the_old_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill_disk(env: ToyEnv, epoch: int, step: int) -> None:
        def fail(*_: Any) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        if epoch == 3:
            monkeypatch.setattr(os, "fsync", fail)

    with pytest.raises(DataError, match="No space left on device"):
        run(tmp_path, toy_config(keep=1), on_step=fill_disk)
    assert [p.name for p in (tmp_path / "checkpoints").iterdir()] == ["000002.pt"]
    assert last(tmp_path).epoch == 2


def test_a_pool_that_is_lost_for_good_leaves_what_was_learned(tmp_path: Path) -> None:
    def lose(env: ToyEnv, epoch: int, step: int) -> None:
        if epoch == 4:
            raise PoolError("worker 0 was lost three times in a row")

    with pytest.raises(PoolError):
        run(tmp_path / "parts", toy_config(every=20, epochs=6), on_step=lose)
    assert [p.name for p in checkpoints.saved(tmp_path / "parts")] == ["000003.pt"]
    run(tmp_path / "parts", toy_config(every=20, epochs=6), resume=True)
    run(tmp_path / "straight", toy_config(every=20, epochs=6))
    assert_same(last(tmp_path / "parts"), last(tmp_path / "straight"))
    with pytest.raises(PoolError):
        run(tmp_path / "first", toy_config(), on_step=lambda env, epoch, step: lose(env, 4, step))
    assert checkpoints.saved(tmp_path / "first") == []


def test_checkpoint_schedule(tmp_path: Path) -> None:
    run(tmp_path, toy_config(epochs=8, every=3, keep=2))
    assert [p.name for p in checkpoints.saved(tmp_path)] == ["000006.pt", "000008.pt"]


def test_evaluation_schedule_and_best_success(tmp_path: Path) -> None:
    given = iter([0.95, 0.9, 0.3, 0.2])

    def evaluate(policy: Policy) -> dict[str, Any]:
        return {"success": next(given), "contact_ratio": 0.5}

    run(tmp_path, toy_config(epochs=5, eval_every=2), evaluate=evaluate)
    successes = {row["epoch"]: row["success"] for row in rows_of(tmp_path) if row["success"]}
    assert successes == {"0": "0.95", "2": "0.9", "4": "0.3", "5": "0.2"}
    # What was there before the training is not its best.
    assert last(tmp_path).best_success == 0.9 and checkpoints.load(tmp_path / "best.pt").epoch == 2


@pytest.mark.parametrize(
    ("epochs", "every", "evaluated"),
    [(20, 100, [0, 2, 5, 10, 15, 20]), (3, 4, [0, 1, 2, 3]), (1, 9, [0, 1]), (4, 4, [0, 4])],
)
def test_a_training_shorter_than_eval_every_is_evaluated_on_the_way(
    tmp_path: Path, epochs: int, every: int, evaluated: list[int]
) -> None:
    config = toy_config(epochs=epochs, eval_every=every)
    run(tmp_path, config, evaluate=lambda policy: {"success": 0.5, "contact_ratio": 0.5})
    assert [int(row["epoch"]) for row in rows_of(tmp_path) if row["success"]] == evaluated


def test_the_share_of_held_episodes_is_logged(tmp_path: Path) -> None:
    config = toy_config(epochs=1)
    assert config.env.hold.first_step is None
    run(tmp_path / "without", config)
    assert "held" not in rows_of(tmp_path / "without")[0]
    hold = config.env.hold.model_copy(update={"first_step": 2, "last_step": 3})
    env = config.env.model_copy(update={"hold": hold})
    run(tmp_path / "with", config.model_copy(update={"env": env}))
    rows = {row["epoch"]: row for row in rows_of(tmp_path / "with")}
    ended = float(rows["1"]["truncated"]) + float(rows["1"]["terminated"])
    assert ended > 0.0 and float(rows["1"]["held"]) == pytest.approx(float(rows["1"]["truncated"]) / ended)


def test_a_directory_with_another_run_is_refused(tmp_path: Path) -> None:
    run(tmp_path, toy_config(epochs=1))
    with pytest.raises(ConfigError, match="already holds checkpoints"):
        Runner(ToyEnv(), toy_config(), tmp_path, {})
    with pytest.raises(DataError, match="no checkpoint there"):
        Runner(ToyEnv(), toy_config(), tmp_path / "other", {}, None, True)


def test_another_architecture_is_refused(tmp_path: Path) -> None:
    run(tmp_path, toy_config(epochs=1))
    with pytest.raises(DataError, match="another architecture"):
        Runner(ToyEnv(), toy_config(hidden=[8]), tmp_path, {}, None, True)
    with pytest.raises(DataError, match="observation_size 4 there, 6 here"):
        Runner(ToyEnv(dims=3), toy_config(), tmp_path, {}, None, True)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("observation", np.nan, "environment 5, epoch 2, step 3: the observation, entry 1, is nan"),
        ("reward", np.inf, "environment 5, epoch 2, step 3: the reward is inf"),
        ("final", -np.inf, "environment 5, epoch 2, step 7: the final observation, entry 1, is -inf"),
    ],
)
def test_numbers_that_are_not_finite_are_refused(tmp_path: Path, name: str, value: float, message: str) -> None:
    def spoil(env: ToyEnv, epoch: int, step: int) -> None:
        array = getattr(env, name)
        at = 7 if name == "final" else 3  # the first episodes are truncated by step 7
        if (epoch, step) == (2, at):
            array[(5, 1) if array.ndim == 2 else 5] = value

    with pytest.raises(DataError, match=message):
        run(tmp_path, toy_config(), on_step=spoil)
    assert last(tmp_path).epoch == 1


def test_truncation_and_termination_reach_the_advantages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The last of 2 steps is made to terminate environment 0 and truncate environment 1; the others continue.
    # With lam = 0, A = r + gamma V' - V, where V' is 0, V(final observation), V(next observation).
    def end(env: ToyEnv, epoch: int, step: int) -> None:
        if step == 2:
            env.terminated[0], env.truncated[1] = True, True
            env.final[1] = 0.5

    config = toy_config(epochs=1, steps=2, lam=0.0, gamma=0.9)
    runner = Runner(ToyEnv(on_step=end), config, tmp_path, {})
    update, seen = runner.ppo.update, {}

    def look(*arguments: Any) -> dict[str, float]:
        rollout = runner.rollout
        with torch.no_grad():
            seen["final"] = runner.model.value(torch.full((1, 4), 0.5))[0]
            seen["next"] = runner.model.value(torch.tensor(runner.env.observation))[2]  # type: ignore[attr-defined]
        seen["got"] = rollout.advantages[1, :3] - rollout.rewards[1, :3] + rollout.values[1, :3]
        return update(*arguments)

    monkeypatch.setattr(runner.ppo, "update", look)
    runner.learn()
    assert seen["got"].tolist() == pytest.approx([0.0, 0.9 * seen["final"].item(), 0.9 * seen["next"].item()], abs=1e-6)



def test_more_minibatches_than_samples_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="101 are more than the 80 samples"):
        Runner(ToyEnv(), toy_config(minibatches=101), tmp_path, {})
    few = toy_config(minibatches=31)
    few = few.model_copy(update={"labels": few.labels.model_copy(update={"per_epoch": 3})})
    with pytest.raises(ConfigError, match="31 are more than the 30 samples"):
        Runner(ToyEnv(), few, tmp_path, {})


def test_cuda_that_is_not_there_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match="cuda is not available"):
        Runner(ToyEnv(), toy_config().model_copy(update={"device": "cuda"}), tmp_path, {})


def test_epochs_have_streams_of_their_own() -> None:
    draws = {tuple(torch.rand(2, generator=epoch_generator(s, e)).tolist()) for s in range(3) for e in range(3)}
    assert len(draws) == 9
    assert torch.equal(torch.rand(2, generator=epoch_generator(1, 2)), torch.rand(2, generator=epoch_generator(1, 2)))
