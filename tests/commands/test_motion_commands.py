"""Motion synthesis as users type it, on a folder of two labels and episodes of a few steps."""

from __future__ import annotations

import json

import pytest

from dgrasp.cli import run_command
from tests.commands.folder import make_folder

SHORT = ["env.episode_steps=6", "env.grasp_steps=3", "eval.window_s=0.1", "motion.steps=3", "pool.kind=serial",
         "motion.stable_alone=false", "physics.substeps=2"]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_folder(tmp_path_factory.mktemp("data") / "set")


@pytest.fixture(scope="module")
def run(folder, tmp_path_factory):
    made = tmp_path_factory.mktemp("runs") / "r"
    words = ["--cfg", "cfg/dexycb.yaml",
             "--data", str(folder), "--run", str(made), "ppo.epochs=1", "ppo.hidden=[8]", "eval.every=9", *SHORT]
    assert run_command("train", words) == 0
    return made


@pytest.fixture
def poses(tmp_path):
    file = tmp_path / "mine.csv"
    file.write_text("dx,dy,dz,qw,qx,qy,qz\n0,0,0.1,1,0,0,0\n0.1,0,0.2,1,0,0,0\n0,0.1,0.2,1,0,0,0\n")
    return file


def test_the_static_grasp_alone_is_one_line(folder, tmp_path, capsys):
    file = tmp_path / "out.json"
    words = ["--baseline", "static_grasp", "--data", str(folder), "--json", str(file), *SHORT]
    assert run_command("test", words) == 0
    result = json.loads(file.read_text())
    assert result["method"] == "static_grasp" and result["n_labels"] == 2 and result["paper"] is None
    assert result["motion"]["targets"] == "near" and result["motion"]["grasp"] == "gt_pd"
    assert result["cost"]["control_steps"] == 2 * 3
    for row in result["per_label"]:
        assert set(row) >= {"object", "index", "target", "mpe_m", "geodesic_rad", "carried"} and "success" not in row
    assert {"mpe_m", "geodesic_rad"} <= set(result["mean_over_objects"])
    assert "motion: near, 3 steps" in file.with_suffix(".md").read_text()
    assert "geodesic rad" in capsys.readouterr().out
    assert file.with_suffix(".csv").is_file() and file.with_suffix(".md").is_file()


def test_a_policy_goes_to_all_poses_of_a_file(run, poses, tmp_path):
    file, gif = tmp_path / "out.json", tmp_path / "out.gif"
    assert run_command("test", ["--run", str(run), "--motion", str(poses), "--json", str(file), "--gif", str(gif)]) == 0
    result = json.loads(file.read_text())
    assert result["method"] == "policy" and result["motion"]["targets"] == "mine.csv"
    assert [(row["object"], row["target"]) for row in result["per_label"]] == [
        (name, k) for name in ("004_sugar_box", "005_tomato_soup_can") for k in range(3)
    ]
    assert result["n_labels"] == 2 and result["per_object"]["004_sugar_box"]["n"] == 3
    # 3 rounds of a grasp of 3 steps and a motion of 3, for 2 labels.
    assert result["cost"]["control_steps"] == 3 * 6 * 2
    assert gif.read_bytes().startswith(b"GIF89a")


def test_the_static_grasp_takes_the_grasps_of_a_policy(run, tmp_path):
    file, path = tmp_path / "out.json", tmp_path / "path.csv"
    path.write_text("t,dx,dy,dz,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0.02,0,0,0.1,1,0,0,0\n")
    words = ["--baseline", "static_grasp", "--run", str(run), "--motion", str(path), "--json", str(file)]
    assert run_command("test", words) == 0
    result = json.loads(file.read_text())
    assert result["method"] == "static_grasp" and result["motion"]["grasp"] == "policy"
    # 0.02 s are 5 control steps of 2 substeps, where a pose would have the 3 of motion.steps.
    assert result["motion"]["steps"] == 5 and "path_mpe_m" in result["mean_over_labels"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "expected one of --baseline, --run and --policy"),
        (["--baseline", "gt_pd", "--policy", "x.pt"], "expected one of --baseline, --run and --policy"),
        (["--baseline", "gt_pd", "--motion", "ood"], "gt_pd holds a pose and moves nothing"),
        (["--baseline", "static_grasp", "--motion", "easy"], "the authors' targets come with their labels"),
        (["--baseline", "static_grasp", "--motion", "none.csv"], "neither easy, near, ood, circle, pour nor a file"),
        (["--baseline", "static_grasp", "motion.steps=0"], "motion.steps"),
    ],
)
def test_wrong_use_is_one_message(folder, capsys, words, said):
    assert run_command("test", [*words, "--data", str(folder), "pool.kind=serial"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ") and said in message and "Traceback" not in message
