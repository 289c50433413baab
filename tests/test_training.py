"""Trainings as a library: where they are, how they begin and go on."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from dgrasp.config.experiment import load_config, make_config
from dgrasp.data import resolve
from dgrasp.errors import ConfigError
from dgrasp.rl.run import checkpoint
from dgrasp.rl.run.record import read_run
from dgrasp.training import _gif, begin, next_run, resume, start_run
from tests.commands.folder import make_folder

SHORT = ["env.episode_steps=6", "env.grasp_steps=3", "physics.substeps=1", "ppo.minibatches=1", "ppo.update_epochs=1",
         "eval.window_s=0.06", "eval.gif=false", "ppo.hidden=[8]", "pool.kind=serial", "ppo.epochs=1"]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_folder(tmp_path_factory.mktemp("data") / "free")


def test_a_run_begins_in_a_directory_of_its_own_and_goes_on_from_there(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    config = load_config(None, [f"data={folder}", "name=mine", *SHORT])
    assert begin(config) == Path("runs/mine_1") and begin(config, Path("here")) == Path("here")
    assert "test it:  dgrasp test --run here" in capsys.readouterr().out
    assert read_run(Path("here")).state == "finished" and read_run(Path("here")).config == config
    with pytest.raises(ConfigError, match="here exists already; continue it with --resume here"):
        begin(config, Path("here"))
    resume(Path("here"), ["ppo.epochs=3"])
    assert checkpoint.latest(Path("here")).stem == "000003" and read_run(Path("here")).config.ppo.epochs == 3
    with pytest.raises(ConfigError, match="so no run to resume"):
        resume(tmp_path)


def test_a_run_that_was_stopped_before_its_first_checkpoint_begins_anew(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = load_config(None, [f"data={folder}", *SHORT])
    start_run(tmp_path / "run", config, resolve(config), new=True)
    resume(tmp_path / "run")
    assert "stopped before its first checkpoint, so it starts from the beginning" in capsys.readouterr().out
    assert checkpoint.latest(tmp_path / "run").stem == "000001"
    for file in checkpoint.saved(tmp_path / "run"):
        file.unlink()
    with pytest.raises(ConfigError, match="its checkpoints are missing after 1 epochs"):
        resume(tmp_path / "run")


def test_runs_that_begin_together_have_a_directory_each(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert [next_run("a"), next_run("a"), next_run("b")] == [Path("runs/a_1"), Path("runs/a_2"), Path("runs/b_1")]
    assert [next_run("a[1]"), next_run("a[1]"), next_run("of/a"), next_run("of/a")] == [
        Path("runs/a[1]_1"), Path("runs/a[1]_2"), Path("runs/of/a_1"), Path("runs/of/a_2")
    ]  # fmt: skip
    config = make_config({"data": str(folder)})
    start_run(Path("mine"), config, resolve(config), new=True)
    # Another process that found the folder empty a moment before.
    before = Path("mine/config.yaml").read_bytes()
    with pytest.raises(ConfigError, match="mine exists already"):
        start_run(Path("mine"), make_config({"data": str(folder), "seed": 2}), resolve(config), new=True)
    assert Path("mine/config.yaml").read_bytes() == before


def test_an_evaluation_in_training_shows_what_there_is_to_show() -> None:
    spec = SimpleNamespace(config=make_config({}, "test"))
    assert _gif([SimpleNamespace(gc=())], 1, spec) == {}  # type: ignore[list-item, arg-type]
