"""Machines that lack something: a home, a folder that can be written to, a stream."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dgrasp.files import paths
from dgrasp.files.paths import shipped_root, user_cache_root
from tests.objects.meshes import box, save


def no_home(*_: object) -> Path:
    raise RuntimeError("Could not determine home directory.")


def test_without_a_home_the_cache_is_a_temporary_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(Path, "home", no_home)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for name in ("DGRASP_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    paths._temporary_cache.cache_clear()
    root = user_cache_root()
    assert root.parent == tmp_path and root.is_dir() and user_cache_root() == root
    # What is named needs no home.
    monkeypatch.setenv("DGRASP_CACHE", str(tmp_path / "mine"))
    assert user_cache_root() == tmp_path / "mine"
    paths._temporary_cache.cache_clear()


_NO_HOME = """
import json, pathlib, sys
def no_home(*_):
    raise RuntimeError("Could not determine home directory.")
pathlib.Path.home = no_home
pathlib.Path.expanduser = no_home
from dgrasp.cli import main
for words in json.loads(sys.argv[1]):
    code = main(words)
    if code:
        sys.exit(code)
"""


def test_commands_run_without_home_and_user(tmp_path: Path) -> None:
    save(box(), tmp_path / "box.obj")
    commands = [
        ["object", "add", "box.obj", "--units", "m", "--to", "objects", "--shape", "parts"],
        ["test", "--baseline", "gt_pd", "--data", "free", "--objects", "004", "labels.limit_per_object=1",
         "env.episode_steps=6", "env.grasp_steps=3", "eval.window_s=0.1", "pool.kind=serial"],
    ]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", _NO_HOME, json.dumps(commands)], cwd=tmp_path, capture_output=True, text=True,
        env={"PYTHONPATH": str(shipped_root()), "OMP_NUM_THREADS": "1", "PATH": os.environ["PATH"]},
    )  # fmt: skip
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert (tmp_path / "objects" / "box").is_dir() and "success" in done.stdout, done.stdout


@pytest.mark.skipif(os.name != "posix", reason="a shell closes the streams")
def test_a_training_runs_with_closed_streams(tmp_path: Path) -> None:
    words = ["train", "--cfg", "cfg/dexycb.yaml", "--data", "free", "--run", "run", "labels.objects=004_sugar_box",
             "labels.limit_per_object=1", "ppo.epochs=1", "env.episode_steps=6", "env.grasp_steps=3", "ppo.hidden=[8]",
             "eval.window_s=0.1", "pool.workers=1"]  # fmt: skip
    command = " ".join([f"'{sys.executable}' -m dgrasp", *(f"'{word}'" for word in words), "<&- >&-"])
    environment = {**os.environ, "PYTHONPATH": str(shipped_root()), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, stderr=subprocess.PIPE, text=True, env=environment)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert (tmp_path / "run" / "checkpoints" / "000001.pt").is_file()
