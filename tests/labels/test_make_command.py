"""`dgrasp labels make`: its files, its errors, and how it goes on where it was stopped."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import pytest

from dgrasp.cli import run_command
from dgrasp.commands import labels_make as make_command
from dgrasp.labels.formats.native import read_native_with_meta
from dgrasp.synthesis import progress
from dgrasp.synthesis.progress import MakingProgress
from dgrasp.types import GraspLabel
from raisim_like.engines import default_engine
from tests.scenes import free_hand, make_label

BRICK = "061_foam_brick"


def labels_of(task) -> list[GraspLabel]:
    """Three labels in the place of synthesised ones."""
    labels = [make_label(free_hand(), index=i) for i in range(3)]
    return [replace(label, object_id=task.model.name) for label in labels]


class InPlace:
    """A pool of no processes."""

    def __init__(self, *arguments: object) -> None: ...

    def __enter__(self) -> InPlace:
        return self

    def __exit__(self, *arguments: object) -> None: ...

    def shutdown(self, *arguments: object, **more: object) -> None: ...


def there(result: object) -> Future:
    """A result that is there."""
    future: Future = Future()
    future.set_result(result)
    return future


def test_the_command_writes_both_splits(
    tmp_path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    row = {"held": 1, "found_held": 0.5, "best_quarter_held": 1.0, "penetration_cm3": 0.5, "touching": 4.0,
           "contacts": 9.0, "diversity_deg": 10.0, "diversity_mm": 20.0, "cpu_s": 1.0}  # fmt: skip

    class Here(InPlace):
        def submit(self, function, task, index):
            return there((labels_of(task), row))

    monkeypatch.setattr(make_command, "ProcessPoolExecutor", Here)
    out = tmp_path / "set.npz"
    words = ["--objects", "061", BRICK, "--number", "3", "--out", str(out), "--test", "1"]
    assert run_command("labels make", words) == 0
    train, meta = read_native_with_meta(tmp_path / "set_train.npz")
    test, _ = read_native_with_meta(tmp_path / "set_test.npz")
    assert (len(train), len(test), meta["licence"], meta["hand"]) == (2, 1, "MIT", "free")
    assert meta["provenance"]["per_object"][BRICK]["held"] == 1 and "cpu_s" not in str(meta)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["set_test.npz", "set_train.npz"]
    assert meta["provenance"]["inertia"] == "true"
    first, *shown = capsys.readouterr().out.splitlines()
    assert first == ("making 3 labels, 3 per object: 061_foam_brick; hand free, engine "
                     f"{default_engine()}, workers 1; true inertia")
    assert "best quarter" in shown[0] and "; true inertia" in shown[1]


def test_a_stopped_run_goes_on(
    tmp_path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    asked: list[str] = []

    class Here(InPlace):
        def submit(self, function, task, index):
            asked.append(task.model.name)
            row = dict.fromkeys(("held", "found_held", "best_quarter_held", "penetration_cm3", "touching",
                                 "contacts", "diversity_deg", "diversity_mm", "cpu_s"), 0.125)  # fmt: skip
            if len(asked) != 2:
                return there((labels_of(task), row))
            stopped: Future = Future()
            stopped.set_exception(KeyboardInterrupt())
            return stopped

    monkeypatch.setattr(make_command, "ProcessPoolExecutor", Here)
    out = tmp_path / "two.npz"
    words = ["--objects", "061", "009", "--number", "3", "--out", str(out)]
    assert run_command("labels make", words) == 130
    assert not out.exists() and len(list((tmp_path / "two.parts").iterdir())) == 1
    # Other labels are not taken for these.
    assert run_command("labels make", [*words, "--seed", "2"]) == 0 and asked[2:] == asked[:2]
    out.unlink()
    assert not (tmp_path / "two.parts").exists()
    asked.clear()
    assert run_command("labels make", words) == 130 and run_command("labels make", words) == 0
    assert asked == ["061_foam_brick", "009_gelatin_box", "009_gelatin_box"]
    assert "1 objects are there" in capsys.readouterr().out
    labels, meta = read_native_with_meta(out)
    assert [label.object_id for label in labels] == ["009_gelatin_box"] * 3 + ["061_foam_brick"] * 3
    assert meta["provenance"]["per_object"]["061_foam_brick"]["held"] == 0.125


def sleep(task, index) -> None:
    """In the place of a synthesis that takes minutes."""
    make_command._shares[index] = 0.5
    time.sleep(20)
    Path(os.environ["ENDED"]).touch()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_ends_the_processes(tmp_path, monkeypatch: pytest.MonkeyPatch, capsys, number: int) -> None:
    class Interrupting(MakingProgress):
        def show(self) -> None:
            if any(self._shares):
                os.kill(os.getpid(), number)
            super().show()

    monkeypatch.setattr(progress, "MakingProgress", Interrupting)
    monkeypatch.setattr(make_command, "_make", sleep)
    monkeypatch.setenv("ENDED", str(tmp_path / "ended"))
    words = ["--objects", "061", "009", "--number", "3", "--out", str(tmp_path / "a.npz"), "--workers", "1"]
    assert run_command("labels make", words) == 130
    assert capsys.readouterr().err == "interrupted\n"
    assert multiprocessing.active_children() == [] and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--number", "0"], "--number 0"),
        (["--out", "nowhere/a.npz"], "folder that exists"),
        (["--objects", "spoon"], "spoon"),
        (["--test", "3"], "--test 3"),
        (["--workers", "0"], "at least one process"),
        (["--hand", "claw"], "claw"),
    ],
)
def test_wrong_options_are_refused(words: list[str], message: str, tmp_path, capsys) -> None:
    base = {"--objects": BRICK, "--number": "3", "--out": str(tmp_path / "a.npz")}
    base[words[0]] = words[1]
    assert run_command("labels make", [word for pair in base.items() for word in pair]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
