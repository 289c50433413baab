"""train and test as users type them, on a folder of two labels and episodes of a few steps."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
import torch
from PIL import Image

from dgrasp.cli import main, run_command
from dgrasp.commands.test import write_gif
from dgrasp.config.experiment import load_config, make_config
from dgrasp.data import resolve
from dgrasp.errors import DataError
from dgrasp.files.paths import shipped_root
from dgrasp.rl.ppo import Ppo
from dgrasp.rl.run import checkpoint
from dgrasp.training import start_run
from tests.commands.folder import make_folder

SHORT = [
    "env.episode_steps=6", "env.grasp_steps=3", "eval.window_s=0.1", "eval.every=2", "checkpoint.every=1",
    "pool.kind=serial", "ppo.hidden=[8]", "labels.doubles_every=3", "env.lengthens_by=1",
]  # fmt: skip

PAPER = ["--cfg", "cfg/dexycb.yaml"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_folder(tmp_path_factory.mktemp("data") / "set")


@pytest.fixture(scope="module")
def trained(folder, tmp_path_factory):
    run = tmp_path_factory.mktemp("runs") / "straight"
    assert run_command("train", [*PAPER, "--data", str(folder), "--run", str(run), "ppo.epochs=4", *SHORT]) == 0
    return run


def test_a_run_directory_holds_what_scripts_rely_on(trained, folder):
    assert [p.name for p in checkpoint.saved(trained)] == [f"{k:06d}.pt" for k in range(1, 5)]
    stamp = json.loads((trained / "data.json").read_text())
    assert stamp["hand"] == "free" and stamp["n_labels"] == 2 and stamp["licence"] == "MIT"
    assert not stamp["comparable_with_paper"] and str(folder) not in json.dumps(stamp)
    assert (trained / "config.yaml").is_file() and list(trained.glob("events.out.tfevents.*"))
    rows = (trained / "progress.csv").read_text().splitlines()
    assert len(rows) == 6 and rows[0].startswith("epoch,")
    assert checkpoint.load(checkpoint.latest(trained)).data == stamp


def test_resume_gives_the_bits_of_the_uninterrupted_run(trained, folder, tmp_path):
    run = tmp_path / "resumed"
    assert run_command("train", [*PAPER, "--data", str(folder), "--run", str(run), "ppo.epochs=2", *SHORT]) == 0
    assert run_command("train", ["--resume", str(run), "ppo.epochs=4"]) == 0
    straight, resumed = (checkpoint.load(checkpoint.latest(r)) for r in (trained, run))
    assert straight.epoch == resumed.epoch == 4
    for name, tensor in straight.model.items():
        assert torch.equal(tensor, resumed.model[name]), name


def test_the_update_has_the_threads_that_it_is_given(folder, tmp_path, monkeypatch):
    threads, update = [], Ppo.update

    def watched(*arguments):
        threads.append(torch.get_num_threads())
        return update(*arguments)

    monkeypatch.setattr(Ppo, "update", watched)
    words = [*PAPER, "--data", str(folder), "--run", str(tmp_path / "run"), *SHORT, "ppo.epochs=1", "ppo.threads=2"]
    assert run_command("train", words) == 0
    assert threads == [2] and torch.get_num_threads() == 1


def test_json_of_a_run_and_of_the_baseline(trained, tmp_path, capsys):
    for words, method in ((["--run", str(trained)], "policy"), (["--baseline", "gt_pd"], "gt_pd")):
        file = tmp_path / f"{method}.json"
        data = [] if method == "policy" else ["--cfg", str(trained / "config.yaml")]
        assert run_command("test", [*words, *data, "--json", str(file)]) == 0
        result = json.loads(file.read_text())
        assert result["schema"] == 1 and result["method"] == method and result["n_labels"] == 2
        assert [(row["object"], row["index"]) for row in result["per_label"]] == [
            ("004_sugar_box", 0), ("005_tomato_soup_can", 0),
        ]  # fmt: skip
        assert result["paper"] is None and result["correlation_with_paper"] is None
        assert result["cost"]["control_steps"] == 2 * ((3 if method == "policy" else 0) + 3)
        assert file.with_suffix(".csv").is_file() and file.with_suffix(".md").is_file()
    assert "not comparable with the paper" in capsys.readouterr().out


def test_objects_option_takes_overrides_behind_it(folder, tmp_path):
    file = tmp_path / "o.json"
    words = ["--baseline", "gt_pd", "--data", str(folder), "--json", str(file), "--objects", "004", "seed=5"]
    assert run_command("test", [*words, "pool.kind=serial", "eval.window_s=0.1"]) == 0
    result = json.loads(file.read_text())
    assert result["seed"] == 5 and list(result["per_object"]) == ["004_sugar_box"]


@pytest.mark.parametrize("suffix", [".csv", ".md", ".tex", ".TEX"])
def test_json_is_not_written_where_a_table_goes(folder, tmp_path, capsys, suffix):
    file = tmp_path / f"o{suffix}"
    assert run_command("test", ["--baseline", "gt_pd", "--data", str(folder), "--json", str(file)]) == 2
    message = capsys.readouterr().err
    assert f"--json {file}" in message and f"such as {tmp_path / 'o.json'}" in message
    assert list(tmp_path.iterdir()) == []


def test_a_gif_of_nothing_is_refused(tmp_path):
    with pytest.raises(DataError, match="no episode lasted a single step"):
        write_gif(tmp_path / "g.gif", [], {})
    assert not (tmp_path / "g.gif").exists()


def test_a_run_is_not_tested_with_other_senses(trained, folder, capsys):
    words = ["--run", str(trained), "--data", str(folder), "env.scaled_features=true"]
    assert run_command("test", words) == 2
    assert "was trained with env.scaled_features=False" in capsys.readouterr().err


def test_a_gif_is_written(folder, tmp_path):
    file = tmp_path / "g.gif"
    words = ["--baseline", "gt_pd", "--data", str(folder), "--gif", str(file)]
    assert run_command("test", [*words, "pool.kind=serial", "eval.window_s=0.3"]) == 0
    assert file.read_bytes().startswith(b"GIF89a")
    with Image.open(file) as image:
        assert image.size == (640, 240)  # Two clips side by side, without a gap for a third.
    surfaces = file.read_bytes()
    assert run_command("test", [*words, "--shapes", "pool.kind=serial", "eval.window_s=0.3"]) == 0
    # The box and the can collide as they look; the hand does not.
    assert file.read_bytes().startswith(b"GIF89a") and file.read_bytes() != surfaces


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["ppo.epoch=3"], "ppo.epoch: unknown key; did you mean 'ppo.epochs'?"),
        (["seed=-1", "ppo.gamma=2", "pool.workers=x"], "pool.workers: "),
        (["seed=-1", "ppo.gamma=2", "pool.workers=x"], "ppo.gamma: "),
        (["labels.objects=[999_none]"], "999_none"),
        (["--cfg", "cfg/none.yaml"], "cfg/none.yaml"),
        (["--data", "/no/such/folder"], "/no/such/folder"),
        (["labels.source=none.npz"], "none.npz"),
        (["ppo.epochs"], "expected key=value"),
    ],
)
def test_bad_input_is_one_message_and_exit_2(folder, tmp_path, capsys, words, said):
    run = tmp_path / "run"
    assert run_command("train", [*PAPER, "--data", str(folder), "--run", str(run), *words]) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ") and said in message and "Traceback" not in message
    assert not run.exists()


def test_what_a_run_is_resumed_with_is_written_down_from_its_first_epoch_on(folder, tmp_path, monkeypatch):
    config = make_config({"data": str(folder), "pool": {"kind": "serial"}})
    start_run(tmp_path / "run", config, resolve(config), new=True)
    words = ["--resume", str(tmp_path / "run"), *SHORT, "env.reward.pose=0.7", "ppo.epochs=1"]
    assert run_command("train", words) == 0
    assert load_config(tmp_path / "run" / "config.yaml").env.reward.pose == 0.7
    assert run_command("test", ["--run", str(tmp_path / "run")]) == 0


def test_a_run_whose_checkpoints_are_gone_is_not_begun_anew(trained, tmp_path, capsys):
    run = shutil.copytree(trained, tmp_path / "run")
    shutil.rmtree(run / "checkpoints")
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    assert run_command("train", ["--resume", str(run), "ppo.epochs=5"]) == 2
    assert "its checkpoints are missing after 4 epochs" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_what_is_beside_a_new_json_stays(folder, tmp_path, capsys):
    (tmp_path / "notes.md").write_text("mine")
    words = ["--baseline", "gt_pd", "--data", str(folder), *SHORT, "--json", str(tmp_path / "notes.json")]
    assert run_command("test", words) == 2
    assert "notes.md would be written beside it" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["notes.md"]
    labels = folder / "labels" / "free_train.npz"
    before = labels.read_bytes()
    words = ["--baseline", "gt_pd", "--data", str(folder), *SHORT, "--labels", str(labels), "--report", str(labels)]
    assert run_command("test", words) == 2
    assert "which is read" in capsys.readouterr().err and labels.read_bytes() == before


def test_names_that_no_file_can_have_are_one_error(folder, tmp_path, capsys):
    long = str(tmp_path / ("x" * 300))
    for command, words in (
        ("train", [*PAPER, "--data", str(folder), "--run", long]), ("runs", [long]), ("test", ["--run", long]),
        ("publish", [long, "--out", str(tmp_path / "a.safetensors")]),
    ):  # fmt: skip
        assert run_command(command, words) == 2, command
        assert capsys.readouterr().err.startswith("error: ")
    for name in ("../a", "a/b", "", "a\0b"):
        assert run_command("train", [*PAPER, "--data", str(folder), f"name={json.dumps(name)}"]) == 2
        assert "name" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--budget", "nan"], ["--budget", "-3"], ["--budget", "x"], ["--seeds", "1,-2"]])
def test_a_table_takes_minutes_and_seeds(words, capsys):
    with pytest.raises(SystemExit):
        run_command("test", ["--table", "grasp", *words])
    assert "expected" in capsys.readouterr().err


def test_a_run_directory_that_exists_is_left_alone(trained, folder, capsys):
    before = {p: p.stat().st_mtime_ns for p in trained.rglob("*")}
    assert run_command("train", [*PAPER, "--data", str(folder), "--run", str(trained), *SHORT]) == 2
    assert "exists already" in capsys.readouterr().err
    assert {p: p.stat().st_mtime_ns for p in trained.rglob("*")} == before


def test_a_checkpoint_of_another_architecture_is_refused(trained, capsys):
    assert run_command("train", ["--resume", str(trained), "ppo.hidden=[9]", "ppo.epochs=5"]) == 2
    assert "architecture" in capsys.readouterr().err


def test_labels_of_another_hand_are_refused(folder, tmp_path, capsys):
    urdf = tmp_path / "other_hand.urdf"
    urdf.write_bytes((folder / "hand" / "free_hand.urdf").read_bytes())
    assert run_command("test", ["--baseline", "gt_pd", "--data", str(folder), f"hand={urdf}"]) == 2
    assert "made for the hand 'free'" in capsys.readouterr().err


def test_fallback_error_forbids_the_free_set(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv("DGRASP_DATA", raising=False)
    monkeypatch.delenv("DEX_YCB_DIR", raising=False)
    assert run_command("test", ["--baseline", "gt_pd", "fallback=error"]) == 2
    assert "forbids the free set" in capsys.readouterr().err


def test_usage_and_help(capsys):
    assert main([]) == 2 and main(["nonsense"]) == 2 and main(["--version"]) == 0 and main(["--help"]) == 0
    for command in ("train", "test", "demo"):
        with pytest.raises(SystemExit) as stop:
            main([command, "--help"])
        assert stop.value.code == 0
    assert "examples:" in capsys.readouterr().out


def test_ctrl_c_leaves_a_usable_checkpoint_and_exits_130(folder, tmp_path):
    run = tmp_path / "interrupted"
    words = ["train.py", *PAPER, "--data", str(folder), "--run", str(run), "ppo.epochs=100000", *SHORT]
    process = subprocess.Popen(
        [sys.executable, *words, "eval.every=100000", "pool.kind=process", "pool.workers=1"], cwd=shipped_root(),
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while not (run / "checkpoints").is_dir() or not checkpoint.saved(run):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 130 and "--resume" in message and "Traceback" not in message
    reached = checkpoint.load(checkpoint.latest(run)).epoch
    assert run_command("train", ["--resume", str(run), f"ppo.epochs={reached + 1}", "pool.kind=serial"]) == 0
    assert checkpoint.load(checkpoint.latest(run)).epoch == reached + 1
