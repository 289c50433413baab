"""`dgrasp grasp`: from a mesh to ranked grasps, motions and files; what is refused before anything is made."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partialmethod
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from dgrasp.cli import run_command
from dgrasp.config.experiment import load_config
from dgrasp.export.sequence import read_sequence
from dgrasp.files.paths import data_root
from dgrasp.grasping.grasps import ranking
from dgrasp.labels.formats.native import read_native_with_meta
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.run.checkpoint import Checkpoint
from dgrasp.rl.run.weights import write_weights
from dgrasp.synthesis import making
from dgrasp.synthesis.synthesiser import Synthesiser
from raisim_like.rotations import transform
from tests.hand.three_fingers import write_three_fingers
from tests.objects.meshes import box, save
from tests.scenes import free_hand, make_label

SHORT = ["eval.window_s=1", "pool.kind=serial", "motion.steps=20"]
SUGAR = "004_sugar_box"
UP = transform(np.eye(3), np.array([0.0, 0.0, 0.3]))


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The whole line on the mesh of a box, then again on the object that it added: folders, contents of the JSON."""
    pytest.importorskip("mujoco")
    folder = tmp_path_factory.mktemp("line")
    save(box((0.05, 0.07, 0.12)), folder / "carton.obj")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DGRASP_CACHE", str(folder / "cache"))
        patch.chdir(folder)
        quick = partialmethod(Synthesiser.make, batch=10, iterations=36)
        patch.setattr(Synthesiser, "make", quick)
        words = ["--number", "2", "--engine", "mujoco", "--store", "mine", "--to", "0 0 0.1", "--seed", "3", *SHORT]
        assert run_command("grasp", ["carton.obj", "--mass", "0.1", *words]) == 0
        assert run_command("grasp", ["carton", "--out", "again", *words]) == 0
    out = folder / "grasps" / "carton"
    return {"out": out, "again": folder / "again", "store": folder / "mine",
            "json": json.loads((out / "grasps.json").read_text())}


def test_the_json_names_what_was_made_and_how(line: dict[str, Any]) -> None:
    found = line["json"]
    meta = json.loads((line["store"] / "carton" / "object.json").read_text())
    assert meta["mass_kg"] == 0.1
    about = {"schema": 1, "object": "carton", "hand": "free", "engine": "mujoco", "policy": "pretrained", "seed": 3,
             "window_s": 1.0, "inertia": "true", "n_grasps": 2}  # fmt: skip
    assert {key: found[key] for key in about} == about
    assert found["data"]["added_objects"] == {"carton": meta["id"]} and len(found["policy_sha256"]) == 64
    assert found["licence"] == found["data"]["licence"] and found["commit"]
    assert found["to"]["targets"] == "0 0 0.1" and found["to"]["steps"] == 20
    assert "null" not in (line["out"] / "grasps.json").read_text() and str(line["out"].parent) not in json.dumps(found)
    grasps = found["grasps"]
    assert sorted(entry["index"] for entry in grasps) == [0, 1]
    assert found["n_held"] == sum(entry["success"] for entry in grasps)
    assert found["n_carried"] == sum(entry.get("carried", False) for entry in grasps)
    for entry in grasps:
        assert entry["sim_dist_mm_per_step"] > 0.0 and entry["success"] == ("failure" not in entry)
        assert ("carried" in entry) == ("mpe_m" in entry) == ("geodesic_rad" in entry) == entry["success"]


def test_the_files_are_those_of_the_grasps_that_hold(line: dict[str, Any]) -> None:
    out, grasps = line["out"], line["json"]["grasps"]
    assert {path.name for path in out.iterdir()} == {"grasps.json", "report.html", "labels.npz", "sequences"}
    named = {entry[key] for entry in grasps for key in ("file", "glb", "motion_file", "motion_glb") if key in entry}
    assert named == {f"sequences/{path.name}" for path in (out / "sequences").iterdir()}
    held = [entry for entry in grasps if entry["success"]]
    assert held, "the policy holds none of this box's grasps: nothing is tested here"
    for entry in held:
        sequence = read_sequence(out / entry["file"])
        assert sequence.record.label.index == entry["index"] and sequence.record.label.object_id == "carton"
        assert sequence.about["row"]["sim_dist_mm_per_step"] == entry["sim_dist_mm_per_step"]
        assert (out / entry["glb"]).read_bytes()[:4] == b"glTF"
        assert ("motion_file" in entry) == entry["carried"]
        if entry["carried"]:
            moved = read_sequence(out / entry["motion_file"]).record
            assert moved.T_WG is not None
            assert np.allclose(moved.T_WG[-1, :3, 3] - moved.label.T_WO[:3, 3], [0.0, 0.0, 0.1], atol=1e-6)
            off = np.linalg.norm(moved.T_WO[-1, :3, 3] - moved.T_WG[-1, :3, 3])
            assert entry["mpe_m"] == pytest.approx(off, abs=1e-6)
    labels, meta = read_native_with_meta(out / "labels.npz")
    assert [label.index for label in labels] == [0, 1] and meta["licence"] == line["json"]["licence"]
    page = (out / "report.html").read_text()
    assert "Grasps of carton" in page and "true inertia" in page and page.count('class="thumb"') == 2 + len(held)


def test_the_same_seed_makes_the_same_again_from_the_added_object(line: dict[str, Any]) -> None:
    for name in ("grasps.json", "labels.npz", "report.html"):
        assert (line["again"] / name).read_bytes() == (line["out"] / name).read_bytes()


def canned(monkeypatch: pytest.MonkeyPatch) -> None:
    """One or two labels in the place of synthesised ones: a hand far above a sugar box, then one that grasps it."""
    free, _ = read_native_with_meta(data_root() / "free" / "labels" / "free_test.npz")
    far = make_label(free_hand())
    assert far.start is not None
    start = replace(far.start, T_WH=UP @ far.start.T_WH)
    far = replace(far, T_WH=UP @ far.T_WH, joints_W=far.joints_W + UP[:3, 3], start=start)
    good = next(label for label in free if label.object_id == SUGAR)
    monkeypatch.setattr(making, "make_labels", lambda *given: ([far, good][: given[2]], {"held": 1}))


def test_a_lost_grasp_comes_last_and_has_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    canned(monkeypatch)
    out = tmp_path / "sugar"
    words = [SUGAR, "--number", "2", "--engine", "mujoco", "--out", str(out), *SHORT]
    assert run_command("grasp", words) == 0
    first, last = json.loads((out / "grasps.json").read_text())["grasps"]
    assert (first["index"], first["success"], last["index"], last["success"]) == (1, True, 0, False)
    assert "failure" in last and "lost_s" in last and not {"file", "glb", "carried", "mpe_m"} & set(last)
    assert first["file"] == f"sequences/{SUGAR}_0001.npz" and "carried" not in first
    assert sorted(path.name for path in (out / "sequences").iterdir()) == [f"{SUGAR}_0001.glb", f"{SUGAR}_0001.npz"]
    shown = capsys.readouterr().out
    assert "[1/2] making 2 labels of 004_sugar_box for the hand free on mujoco; true inertia" in shown
    assert "[2/2] testing 2 grasps of the policy pretrained" in shown and "licence: MIT" in shown
    assert "1 of 2 grasps hold for 1 s" in shown and f"dgrasp view {out / 'sequences'}" in shown
    # The folder is replaced by the next run, but not once it holds something else.
    (out / "sequences" / "view.html").write_text("a page of dgrasp view")
    assert run_command("grasp", [*words, "--seed", "2"]) == 0
    assert json.loads((out / "grasps.json").read_text())["seed"] == 2
    (out / "notes.txt").write_text("mine")
    assert run_command("grasp", words) == 2
    assert "notes.txt" in capsys.readouterr().err and (out / "notes.txt").read_text() == "mine"


def test_where_nothing_holds_nothing_is_carried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    canned(monkeypatch)
    words = [SUGAR, "--number", "1", "--engine", "mujoco", "--out", str(tmp_path / "none"), "--to", "0 0 0.1", *SHORT]
    assert run_command("grasp", words) == 0
    found = json.loads((tmp_path / "none" / "grasps.json").read_text())
    assert found["n_held"] == 0 and "to" not in found and "n_carried" not in found
    assert list((tmp_path / "none" / "sequences").iterdir()) == []
    shown = capsys.readouterr().out
    assert "0 of 1 grasps hold for 1 s" in shown and "next: the same command with another --seed" in shown


def test_another_hand_with_its_own_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    hand = write_three_fingers(tmp_path / "three.urdf")
    config, data = load_config(None).model_dump(mode="json"), {"hand": "three"}
    model = ActorCritic(102, 12, [4], 1.0, torch.Generator().manual_seed(0))
    policy = tmp_path / "three.safetensors"
    write_weights(policy, Checkpoint(1, model.state_dict(), {}, 1e-3, model.architecture(), config, data, "0", None))
    monkeypatch.setattr(Synthesiser, "make", partialmethod(Synthesiser.make, batch=36, iterations=30))
    words = ["061_foam_brick", "--hand", str(hand), "--number", "2", "--seed", "3", "--engine", "mujoco", *SHORT]
    out = tmp_path / "brick"
    assert run_command("grasp", [*words, "--policy", str(policy), "--out", str(out)]) == 0
    found = json.loads((out / "grasps.json").read_text())
    assert (found["hand"], found["policy"], found["n_grasps"]) == ("three", "three.safetensors", 2)
    assert len(list((out / "sequences").glob("*.npz"))) == found["n_held"]


def test_held_grasps_come_first_then_small_distances() -> None:
    rows = [{"success": False, "sim_dist_mm_per_step": 0.1}, {"success": True, "sim_dist_mm_per_step": 2.0},
            {"success": False}, {"success": True, "sim_dist_mm_per_step": 1.0},
            {"success": False, "sim_dist_mm_per_step": 0.1}]  # fmt: skip
    assert ranking(rows) == [3, 1, 0, 4, 2]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["a.obj", "--number", "0"], "--number 0: expected 1 to 1000 grasps"),
        (["a.obj", "--seed", "-1"], "--seed -1"),
        (["none.obj"], "none.obj: no such mesh file"),
        (["bad.obj"], "bad.obj"),
        (["folder"], "folder: a folder; expected a mesh file"),
        (["cupp"], "unknown object 'cupp'"),
        (["a.obj", "--mass", "0"], "--mass 0: expected a positive number"),
        (["a.obj", "--name", "025_mug"], "is one of the 20"),
        (["025_mug", "--mass", "1"], "--mass: only for a mesh file"),
        (["a.obj", "--to", "0 0"], "--to '0 0': 2 numbers; expected \"dx dy dz\" or \"dx dy dz qw qx qy qz\""),
        (["a.obj", "--to", "up"], "--to 'up': neither numbers nor a file"),
        (["a.obj", "--to", "0 0 nan"], "is not finite"),
        (["a.obj", "--to", "-0.1 0 200"], "beyond 10 m"),
        (["a.obj", "--to", "0 0 0.1 1 1 0 0"], "not of length 1"),
        (["a.obj", "--to", "two.csv"], "two.csv: 2 targets; expected one pose"),
        (["a.obj", "--out", "taken"], "`dgrasp grasp` did not write it"),
        (["a.obj", "--out", "a.obj"], "is not a folder"),
        (["a.obj", "--out", "a.obj/b"], "is not a folder that can be written to"),
        (["a.obj", "--out", "."], "the current folder"),
        (["a.obj", "--policy", "none.pt"], "none.pt: no such file"),
        (["a.obj", "--hand", "claw"], "claw: no hand"),
        (["a.obj", "--hand", "three.urdf"], "--policy pretrained: trained for the hand 'free', but --hand is 'three'"),
        (["a.obj", "engine=mujoco"], "engine=mujoco: not a key of this command"),
        (["a.obj", "eval.windows=1"], "did you mean 'eval.window_s'?"),
    ],
)
def test_bad_input_is_refused_before_anything_is_made(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    save(box(), tmp_path / "a.obj")
    (tmp_path / "bad.obj").write_text("v 1 2: [\n")
    (tmp_path / "folder").mkdir()
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "grasps.json").write_text("{}")
    (tmp_path / "two.csv").write_text("dx,dy,dz,qw,qx,qy,qz\n0,0,0.1,1,0,0,0\n0,0,0.2,1,0,0,0\n")
    write_three_fingers(tmp_path / "three.urdf")
    before = sorted(tmp_path.rglob("*"))
    assert run_command("grasp", [*words, "--store", "mine"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ") and len(message) < 400 and said in message
    assert sorted(tmp_path.rglob("*")) == before
