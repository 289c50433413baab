"""Ctrl-C and SIGTERM end every command in order: exit code 130, and nothing is left behind."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dgrasp.cli import run_command
from dgrasp.commands import runs
from dgrasp.rl.run.interrupts import check_interrupted, interruptible

STOPPED = """
import os, signal, sys
from dgrasp import evaluation
from dgrasp.cli import run_command

class Stopping(evaluation._Progress):
    def __call__(self, done, total):
        os.kill(os.getpid(), {number})
        super().__call__(done, total)

if __name__ == "__main__":
    evaluation._Progress = Stopping
    sys.exit(run_command("test", ["--baseline", "gt_pd", "--data", "free", "--objects", "061_foam_brick",
                                  "labels.limit_per_object=1", "eval.interpenetration=false", "pool.kind=process",
                                  "pool.workers=1"]))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_a_signal_stops(monkeypatch: pytest.MonkeyPatch, capsys, number: signal.Signals) -> None:
    def stop(arguments: object) -> int:
        os.kill(os.getpid(), number)
        return 0

    before = signal.getsignal(number)
    monkeypatch.setattr(runs, "main", stop)
    assert run_command("runs", []) == 130
    assert capsys.readouterr().err == "interrupted\n" and signal.getsignal(number) == before


def test_an_interruption_that_was_swallowed_comes_again() -> None:
    with pytest.raises(KeyboardInterrupt), interruptible():
        with contextlib.suppress(BaseException):
            os.kill(os.getpid(), signal.SIGTERM)
        check_interrupted()
    check_interrupted()


def test_a_training_does_not_begin_after_a_swallowed_interruption() -> None:
    begun = False
    with pytest.raises(KeyboardInterrupt), interruptible():
        with contextlib.suppress(BaseException):
            os.kill(os.getpid(), signal.SIGINT)
        with interruptible():
            begun = True
    assert not begun


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_test_frees_its_shared_memory(tmp_path: Path, number: int) -> None:
    """multiprocessing's resource tracker would warn of what is left."""
    script = tmp_path / "stopped.py"
    script.write_text(STOPPED.format(number=int(number)))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode == 130 and done.stderr == "interrupted\n", done.stderr
