"""Where the worker processes of a pool cannot start, one message says why."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dgrasp.files.paths import shipped_root
from dgrasp.pool import PoolError
from dgrasp.pool.worker import shared_arrays

SCRIPT = """
import gymnasium, dgrasp.gym
env = gymnasium.make_vec("dgrasp/Grasp-v0", num_envs=1, pool="process", overrides=["pool.workers=1"])
print("made", env.reset(seed=1)[0].shape[0])
env.close()
"""
GUARDED = 'if __name__ == "__main__":' + SCRIPT.replace("\n", "\n    ")


def run(words: list[str], text: str | None, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(shipped_root()), "OMP_NUM_THREADS": "1"}
    return subprocess.run([sys.executable, *words], input=text, cwd=cwd, capture_output=True, text=True, timeout=120,
                          env=environment)  # fmt: skip


def test_a_script_without_a_guard_is_told_of_it(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    done = run(["script.py"], None, tmp_path)
    assert done.returncode == 1 and done.stderr.count("Traceback") == 1 and "made" not in done.stdout
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("dgrasp.pool.base.PoolError: a worker process runs the script that started it")
    assert 'if __name__ == "__main__":' in last and "memory" not in done.stderr


def test_a_script_with_a_guard_runs(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(GUARDED)
    done = run(["script.py"], None, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "made 1\n", "")


def test_a_script_from_standard_input_is_told_to_be_a_file(tmp_path: Path) -> None:
    done = run(["-"], SCRIPT, tmp_path)
    assert done.returncode == 1 and done.stderr.count("Traceback") == 1
    last = done.stderr.strip().splitlines()[-1]
    assert "<stdin>: worker processes start from the file of the script" in last and "as a file, put what" in last


def test_shared_memory_that_cannot_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if not os.path.isdir("/dev/shm"):
        pytest.skip("only Linux hands out shared memory that is not there")
    before = os.listdir("/dev/shm")
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(PoolError, match=r"3\.0 MiB of shared memory .* \(No space left on device\)") as caught:
        shared_arrays({"a": ((3 * 2**17,), np.float64)})
    # Fewer labels in an epoch need as much: the arrays have rows for all environments.
    assert "pool.kind=serial" in str(caught.value) and "per_epoch" not in str(caught.value)
    assert os.listdir("/dev/shm") == before
