"""`dgrasp runs`, and runs as real processes: pre-empted, killed, started twice."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from dgrasp.cli import main, run_command
from dgrasp.files.paths import shipped_root
from dgrasp.rl.run import checkpoint
from dgrasp.rl.run.lock import is_running, only_run
from dgrasp.rl.run.record import read_run
from raisim_like.engines import default_engine
from tests.commands.folder import make_folder

SHORT = ["env.episode_steps=6", "env.grasp_steps=3", "physics.substeps=1", "ppo.minibatches=1", "ppo.update_epochs=1",
         "eval.window_s=0.06", "eval.gif=false", "checkpoint.every=1", "ppo.hidden=[8]"]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_folder(tmp_path_factory.mktemp("data") / "free")


def _train(folder: Path, run: Path, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "train.py", "--cfg", "cfg/dexycb.yaml",
               "--data", str(folder), "--run", str(run), *SHORT, *words]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, cwd=shipped_root(), stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
                            env=environment)  # fmt: skip


def _wait_for_epoch(run: Path, epoch: int, process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 180
    while not checkpoint.saved(run) or int(checkpoint.latest(run).stem) < epoch:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.1)


def test_sigterm_saves_and_ends_well(folder: Path, tmp_path: Path) -> None:
    process = _train(folder, tmp_path / "run", "ppo.epochs=100000", "eval.every=100000", "pool.workers=1")
    _wait_for_epoch(tmp_path / "run", 1, process)
    assert is_running(tmp_path / "run")
    process.terminate()
    _, message = process.communicate(timeout=60)
    assert process.returncode == 0 and "--resume" in message and "Traceback" not in message
    assert not is_running(tmp_path / "run")
    checkpoint.load(checkpoint.latest(tmp_path / "run"))


def test_after_a_kill_the_weights_are_those_of_a_run_that_never_stopped(
    folder: Path, tmp_path: Path, engine: str
) -> None:
    words = ["eval.every=100000", "pool.kind=serial", f"engine={engine}", "physics.substeps=2"]
    process = _train(folder, tmp_path / "killed", "ppo.epochs=100000", *words)
    _wait_for_epoch(tmp_path / "killed", 2, process)
    process.kill()
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL
    end = int(checkpoint.latest(tmp_path / "killed").stem) + 2
    assert run_command("train", ["--resume", str(tmp_path / "killed"), f"ppo.epochs={end}"]) == 0
    straight = ["--cfg", "cfg/dexycb.yaml",
                "--data", str(folder), "--run", str(tmp_path / "straight"), *SHORT, f"ppo.epochs={end}", *words]
    assert run_command("train", straight) == 0
    a, b = (checkpoint.load(checkpoint.latest(tmp_path / name)) for name in ("killed", "straight"))
    assert a.epoch == b.epoch == end
    assert all(torch.equal(a.model[name], b.model[name]) for name in b.model)


def test_a_full_disk_ends_the_run_and_leaves_the_checkpoint_before(folder: Path, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    if not hasattr(resource, "prlimit"):
        pytest.skip("this system has no prlimit to forbid a running process large files with")
    process = _train(folder, tmp_path / "run", "ppo.epochs=100000", "eval.every=100000", "pool.workers=1")
    _wait_for_epoch(tmp_path / "run", 1, process)
    # From now on no file can grow beyond 100 bytes, as on a full disk.
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (100, 100))
    _, message = process.communicate(timeout=60)
    assert process.returncode == 2 and "File too large" in message and "unharmed" in message, message
    assert "Traceback" not in message
    checkpoint.load(checkpoint.latest(tmp_path / "run"))


def test_a_run_directory_belongs_to_one_process(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    words = ["--cfg", "cfg/dexycb.yaml",
             "--data", str(folder), "--run", str(run), *SHORT, "ppo.epochs=1", "pool.kind=serial"]
    assert run_command("train", words) == 0
    with only_run(run):
        assert is_running(run)
        # flock belongs to an open file, not to a process, so this process can play the part of another.
        assert run_command("train", ["--resume", str(run), "ppo.epochs=2"]) == 2
    assert "another process is training there" in capsys.readouterr().err
    assert checkpoint.load(checkpoint.latest(run)).epoch == 1


def test_the_best_checkpoint_is_kept_and_can_be_tested(folder: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    words = ["--cfg", "cfg/dexycb.yaml",
             "--data", str(folder), "--run", str(run), *SHORT, "ppo.epochs=2", "eval.every=1", "pool.kind=serial"]
    assert run_command("train", words) == 0
    best = checkpoint.load(run / "best.pt")
    assert best.best_success == checkpoint.load(checkpoint.latest(run)).best_success
    assert [path.name for path in checkpoint.saved(run)] == ["000001.pt", "000002.pt"]
    words = ["--policy", str(run / "best.pt"), "--data", str(folder), *SHORT, "pool.kind=serial"]
    assert run_command("test", words) == 0


def test_runs_are_listed_and_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    header = "epoch,control_steps,seconds,core_hours,return,success\n"
    for name, seed, rows in (("a", 1, "0,0,1.0,0.0,,0.1\n10,1000,60.0,0.5,-3,0.4\n20,2000,120.0,1.0,-2,0.3\n"),
                             ("b", 2, "0,0,1.0,0.0,,0.7\n10,1000,50.0,0.25,-3,0.6\n")):
        run = tmp_path / name
        (run / "checkpoints").mkdir(parents=True)
        (run / "checkpoints" / "000010.pt").touch()
        (run / "config.yaml").write_text(f"seed: {seed}\nenv: {{episode_steps: 100}}\nppo: {{epochs: 20}}\n")
        (run / "data.json").write_text('{"kind": "free", "split": "train", "n_labels": 1}')
        (run / "progress.csv").write_text(header + rows)
    for name, limits in (("steps", "max_steps: 1099"), ("time", "max_minutes: 0.5")):
        shutil.copytree(tmp_path / "b", tmp_path / name)
        (tmp_path / name / "config.yaml").write_text(f"env: {{episode_steps: 100}}\nppo: {{epochs: 20, {limits}}}\n")
    # Since the run was resumed, an epoch has two labels: one more epoch of 200 steps fits before it has four.
    shutil.copytree(tmp_path / "b", tmp_path / "resumed")
    (tmp_path / "resumed" / "config.yaml").write_text(
        "env: {episode_steps: 100}\nlabels: {per_epoch: 2, doubles_every: 12}\nppo: {epochs: 20, max_steps: 1799}\n"
    )
    (tmp_path / "resumed" / "data.json").write_text('{"kind": "free", "split": "train", "n_labels": 9}')
    (tmp_path / "resumed" / "progress.csv").write_text(header + rows + "11,1200,60.0,0.3,-3,\n")
    # Damaged lines, such as a power failure or an editor leaves, are ignored.
    with open(tmp_path / "b" / "progress.csv", "ab") as stream:
        stream.write(b"11,x,50.0,0.3,-3,0.7\n12,1200,\xff\xfe,0.3,-3,0.8\n\0\0\0\0")
    # Runs of today also say the inertia of their objects.
    stamp = '{"kind": "free", "split": "train", "n_labels": 1, "inertia": "true"}'
    (tmp_path / "steps" / "data.json").write_text(stamp)
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "config.yaml").write_text("engine: mujoco\n")
    assert main(["runs", str(tmp_path)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()]
    engine = default_engine()
    assert lines[1] == ["a", "finished", "free", "train", engine, "all", "20/20", "2,000", "1.00", "0.300", "0.400"]
    assert lines[2] == ["b", "stopped", "free", "train", engine, "all", "10/20", "1,000", "0.25", "0.600", "0.600"]
    assert lines[3] == ["new", "new", "?", "mujoco", "all", "0/10000", "0", "0.00", "-", "-"]
    assert lines[4][:2] == ["resumed", "stopped"] and lines[4][6] == "11/12"
    assert lines[5][:6] == ["steps", "finished", "free", "train,", "true", "inertia"] and lines[5][8] == "10/10"
    assert lines[6][:2] == ["time", "finished"] and lines[6][6] == "10/20"
    # max_minutes is the share of a budget, so a run that reached it can continue.
    assert read_run(tmp_path / "steps").complete and not read_run(tmp_path / "time").complete
    assert main(["runs", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    out = capsys.readouterr().out
    lines = [line.split() for line in out.splitlines() if line.strip()]
    assert ["seed", "1", "2"] in lines
    # The comparison ends with the shorter run.
    assert lines[-1] == ["1,000", "0.400", "0.600"]


def test_a_run_of_another_version_does_not_hide_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, text in (("a", "engine: mujoco\n"), ("b", "gravity: up\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.yaml").write_text(text)
    assert main(["runs", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    lines = [line.split() for line in out.splitlines() if line.strip()]
    assert lines[1][:2] == ["a", "new"] and lines[2] == ["b", "unreadable"] and "gravity: unknown key" in out


def test_what_is_not_a_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", str(tmp_path / "nowhere")]) == 2
    assert main(["runs", str(tmp_path), str(tmp_path)]) == 2
    assert "not a run directory" in capsys.readouterr().err
    assert main(["runs", str(tmp_path)]) == 0
    assert "no runs in this folder" in capsys.readouterr().out
