"""The whole line with a hand that is no human one: labels made, trained, tested, stored, exported, replayed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dgrasp.cli import main
from dgrasp.config.experiment import make_config
from dgrasp.export.sequence import read_sequence, sequence_files
from dgrasp.hand.store import open_hand
from dgrasp.labels.formats.native import write_native
from dgrasp.objects.free import free_object
from dgrasp.rl.run import checkpoint
from dgrasp.synthesis.synthesiser import Synthesiser
from tests.hand.three_fingers import write_three_fingers

OBJECT = "061_foam_brick"
SHORT = [
    "env.episode_steps=6", "env.grasp_steps=3", "eval.window_s=0.1", "checkpoint.every=1", "ppo.hidden=[8]",
    "ppo.epochs=2", "eval.every=2", "pool.kind=serial",
]  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the hand and labels that the synthesiser makes for it."""
    folder = tmp_path_factory.mktemp("three")
    hand = open_hand(str(write_three_fingers(folder / "three.urdf"))).model
    config = make_config({"engine": "mujoco", "eval": {"window_s": 0.1}})
    rng = np.random.default_rng(3)
    synthesised = Synthesiser(hand).make(free_object(OBJECT, "official", True), 2, rng, config, batch=36, iterations=30)
    write_native(folder / "three.npz", synthesised.labels, "made by a test", "MIT", hand.layout.names)
    return folder


def test_made_labels_touch_the_object_with_the_thumb_and_another_finger(made: Path) -> None:
    from dgrasp.labels.load import load_labels

    labels = load_labels(made / "three.npz")
    assert labels.hand == "three" and len(labels.labels) == 2
    for label in labels.labels:
        assert label.hand_pose.shape == (6,) and label.joints_W.shape == (10, 3) and label.goal_contacts.shape == (7,)
        assert label.goal_contacts[6] and label.goal_contacts[1:6].any()


def test_the_whole_line(made: Path, tmp_path: Path, engine: str, capsys: pytest.CaptureFixture[str]) -> None:
    data = ["--data", "free", f"hand={made / 'three.urdf'}", f"engine={engine}"]
    run, records = tmp_path / "run", tmp_path / "records"
    training = ["train", "--cfg", "cfg/dexycb.yaml", "--run", str(run), *data, *SHORT]
    training.append(f"labels.source={made / 'three.npz'}")
    assert main(training) == 0
    trained = checkpoint.load(checkpoint.latest(run))
    # 12 coordinates, 3 + 3 wrist rates, 6 finger rates, 30 of key points, 9 angles, 9 of the object, 3 x 7 contacts, 9.
    assert trained.epoch == 2 and trained.architecture["observation_size"] == 12 + 6 + 6 + 30 + 9 + 9 + 21 + 9
    assert trained.architecture["action_size"] == 12
    result = tmp_path / "result.json"
    words = ["--run", str(run), "--json", str(result), "--records", str(records), "--report", str(tmp_path / "r.html"),
             "--gif", str(tmp_path / "g.gif")]  # fmt: skip
    assert main(["test", *words]) == 0
    rows = json.loads(result.read_text())["per_label"]
    assert [(row["object"], row["index"]) for row in rows] == [(OBJECT, 0), (OBJECT, 1)]
    assert all("success" in row and "label_distance_mm" in row for row in rows)
    for method in ("gt_pd", "gt_ik", "static_grasp"):
        more = ["--motion", "near", "motion.stable_alone=false", "motion.steps=3"] if method == "static_grasp" else []
        source = [f"labels.source={made / 'three.npz'}", "eval.window_s=0.1", "pool.kind=serial", *more]
        assert main(["test", "--baseline", method, *data, *source]) == 0
    first = sequence_files(records)[0]
    stored = read_sequence(first)
    assert stored.names.parts[-1] == "thumb_0" and stored.record.gc.shape[1] == 12
    assert stored.meshes.bodies[-1] == "object" and all(len(mesh.faces) for mesh in stored.meshes.hand)
    arrays_out, glb_out = tmp_path / "arrays.npz", tmp_path / "film.glb"
    assert main(["export", str(first), "--out", str(arrays_out)]) == 0
    with np.load(arrays_out) as arrays:
        meta = json.loads(str(arrays["meta"]))
        assert meta["joints"][0] == "long_0_joint" and arrays["joint_angles"].shape[1] == 6
        assert "mano_hand_pose" not in arrays
    assert main(["export", str(first), "--out", str(glb_out)]) == 0
    glb = glb_out.read_bytes()
    assert glb[:4] == b"glTF" and b'"name":"thumb_0"' in glb
    assert main(["view", str(records), "--out", str(tmp_path / "view.html"), "--no-browser"]) == 0
    for page in (tmp_path / "r.html", tmp_path / "view.html"):
        assert OBJECT in page.read_text(encoding="utf-8")
    assert "error" not in capsys.readouterr().err


def test_labels_of_another_hand_are_refused_by_their_names(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two hands whose files have one name and other joints."""
    other = made / "other"
    other.mkdir(exist_ok=True)
    path = write_three_fingers(other / "three.urdf")
    path.write_text(path.read_text("utf-8").replace("long_0_joint", "knuckle"), encoding="utf-8")
    words = ["test", "--baseline", "gt_pd", "--data", "free", f"hand={path}", f"labels.source={made / 'three.npz'}"]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "'long_0_joint' in the labels, 'knuckle' in the hand" in said and said.count("\n") == 1
