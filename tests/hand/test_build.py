"""Built hands: what the physics loads is the hand that was skinned; ids that tell hands apart; the command."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from dgrasp.cli import main, run_command
from dgrasp.config.experiment import make_config
from dgrasp.data import resolve
from dgrasp.errors import DataError
from dgrasp.geometry import approximate
from dgrasp.hand.builder.build import DENSITY
from dgrasp.hand.builder.limits import label_limits
from dgrasp.hand.builder.segment import closed_volume
from dgrasp.hand.mano.file import read_mano
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.hand.mano.model import MIRROR, MIRROR_ANGLES, ManoModel
from dgrasp.hand.mano.skeleton import DOF_NAMES, KEYPOINTS, PARTS, TIPS
from dgrasp.hand.mano.skinning import euler_rotations, numpy_skin
from dgrasp.hand.store import NamedHand, built_hand, open_hand
from dgrasp.labels.formats.native import write_native
from dgrasp.labels.recorded.mirror import mirror_label
from dgrasp.objects.free import free_object
from tests.engines import needs_pybullet
from tests.hand.mano_file import mano_arrays, write_mano
from tests.scenes import OneScene, make_label

BETAS = np.array([0.5, -0.3])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A MANO file, the right hand of it in primitives and the left one in hulls."""
    folder = tmp_path_factory.mktemp("hands")
    words = ["--mano", str(write_mano(folder / "MANO_RIGHT.pkl")), "--betas", "0.5", "-0.3"]
    with pytest.MonkeyPatch.context() as patch:
        # Rougher fits, for speed; test_approximate.py looks at good ones.
        patch.setattr(approximate, "_FIT_POINTS", 1500)
        patch.setattr(approximate, "_REPORT_POINTS", 6000)
        assert run_command("hand build", [*words, "--out", str(folder / "right")]) == 0
    words += ["--side", "left", "--shapes", "hulls"]
    assert run_command("hand build", [*words, "--out", str(folder / "left")]) == 0
    return folder


@pytest.fixture(scope="module")
def model(place: Path) -> ManoModel:
    return read_mano(place / "MANO_RIGHT.pkl")


@pytest.fixture(scope="module")
def right(place: Path) -> NamedHand:
    return open_hand(str(place / "right"))


@pytest.fixture(scope="module")
def left(place: Path) -> NamedHand:
    return open_hand(str(place / "left"))


def test_kinematics_are_those_of_the_skin(right: NamedHand, model: ManoModel) -> None:
    rng = np.random.default_rng(0)
    gc = np.concatenate([rng.normal(size=(4, 3)), rng.uniform(-1, 1, (4, 48))], axis=1)
    gc[0, 3:] = 0.0
    R_WH, joints = right.model.forward(gc, np.tile(np.eye(3), (4, 1, 1)), np.zeros((4, 3)))
    rotations = euler_rotations(gc[:, 3:].reshape(4, 16, 3))
    _, keypoints = numpy_skin(model).forward(rotations, gc[:, :3], BETAS[None])
    rigid = [i for i in range(len(KEYPOINTS)) if i not in TIPS]
    # Offsets are written with six decimals and add up over four joints; the skin's tips also stretch with the pose.
    assert np.abs(joints[:, rigid] - keypoints[:, rigid]).max() < 4e-6
    assert np.abs(joints[0] - keypoints[0]).max() < 4e-6
    assert np.abs(joints - keypoints).max() < 0.02
    assert np.abs(R_WH - rotations[:, 0]).max() < 1e-12


def test_the_order_of_joints_is_the_authors(right: NamedHand, left: NamedHand) -> None:
    for hand in (right, left):
        assert hand.model.urdf.joint_names == DOF_NAMES
        assert [hand.model.urdf.links[i].name for i in hand.model.part_links] == list(PARTS)


def test_masses_add_up_and_inertias_are_real(right: NamedHand, model: ManoModel) -> None:
    vertices, _ = model.shaped(BETAS)
    links = right.model.urdf.links
    volume = closed_volume(vertices, model.faces)
    small = 1e-5 * (51 - 16)
    assert right.model.urdf.mass - small == pytest.approx(DENSITY * volume, rel=1e-4)
    for i in right.model.part_links:
        low, middle, high = np.linalg.eigvalsh(links[i].inertia)
        assert 0 < low <= middle <= high < low + middle
    # The solid's centre of mass: the parts' volumes weigh the parts' centres.
    assert np.abs(links[right.model.part_links[0]].com - [-0.045, 0.0, 0.0]).max() < 0.01


def test_shapes(right: NamedHand, left: NamedHand) -> None:
    for i, name in enumerate(PARTS):
        (ours,), (hull,) = (h.model.urdf.links[h.model.part_links[i]].shapes for h in (right, left))
        assert ours.kind == ("box" if name == "palm" else "capsule") and hull.kind == "hull"
        assert right.meta["parts"][name]["overlap"] > 0.55
        assert 0.5 < left.meta["parts"][name]["overlap"] <= 1.0001
    assert right.meta["parts"]["palm"]["overlap"] > 0.7


def test_the_left_hand_is_the_mirror_image(right: NamedHand, left: NamedHand) -> None:
    a, b = right.model, left.model
    assert (right.meta["side"], left.meta["side"]) == ("right", "left")
    assert b.id.startswith("mano_left-") and a.id.startswith("mano_right-")
    assert np.array_equal(b.offsets, a.offsets * MIRROR) and np.array_equal(b.tips, a.tips * MIRROR)
    limits = np.sort(a.limits[6:].reshape(15, 3, 2) * MIRROR_ANGLES[:, None], axis=2)
    assert np.abs(b.limits[6:].reshape(15, 3, 2) - limits).max() < 2e-6
    gc = np.random.default_rng(1).uniform(-1, 1, (3, 51))
    mirrored = gc * np.concatenate([MIRROR, np.tile(MIRROR_ANGLES, 16)])
    here, there = (m.forward(c, np.eye(3)[None], np.zeros((1, 3)))[1] for m, c in ((a, gc), (b, mirrored)))
    assert np.abs(here * MIRROR - there).max() < 1e-12
    for i in a.part_links:
        assert b.urdf.links[i].mass == pytest.approx(a.urdf.links[i].mass, abs=2e-6)
        assert b.urdf.links[i].com == pytest.approx(a.urdf.links[i].com * MIRROR, abs=2e-6)


def test_a_left_file_gives_the_left_hand(left: NamedHand, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arrays = mano_arrays(side="left")
    words = ["--mano", str(write_mano(tmp_path / "MANO_LEFT.pkl", arrays)), "--betas", "0.5", "-0.3"]
    assert run_command("hand build", [*words, "--shapes", "hulls", "--out", str(tmp_path / "own")]) == 0
    assert "note: MANO's left file" in capsys.readouterr().out
    own = open_hand(str(tmp_path / "own"))
    # The same geometry, down to the id: names and numbers are all that the physics reads.
    assert own.model.id == left.model.id and own.meta["model_sha256"] != left.meta["model_sha256"]


@pytest.mark.parametrize("name", ["right", "left"])
def test_pybullet_and_mujoco_load_the_file_itself(place: Path, name: str) -> None:
    path = place / name / "hand.urdf"
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(str(path), useFixedBase=1, flags=pybullet.URDF_USE_INERTIA_FROM_FILE)
        kinds = [pybullet.getJointInfo(body, i)[2] for i in range(pybullet.getNumJoints(body))]
        assert sum(kind != pybullet.JOINT_FIXED for kind in kinds) == 51
        shapes = [pybullet.getCollisionShapeData(body, i) for i in range(len(kinds))]
        assert sum(map(len, shapes)) == 16 and len(pybullet.getVisualShapeData(body)) == 16
    finally:
        pybullet.disconnect(client)
    import mujoco

    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert (compiled.nq, compiled.ngeom) == (51, 16)
    names = [mujoco.mj_id2name(compiled, mujoco.mjtObj.mjOBJ_JOINT, j) for j in range(51)]
    assert names == list(DOF_NAMES)
    assert compiled.body_mass.sum() == pytest.approx(open_hand(str(path)).model.urdf.mass, rel=1e-6)


@needs_pybullet
@pytest.mark.parametrize("name", ["right", "left"])
def test_the_hand_holds_its_pose_in_the_scene(place: Path, name: str) -> None:
    hand = open_hand(str(place / name)).model
    config = make_config({})
    scene = OneScene(hand, free_object("004_sugar_box", "ycb", False), config.physics, "pybullet")
    pose = np.zeros(45)
    pose[2::3] = 0.4 if name == "right" else -0.4
    base, away = np.eye(4), np.eye(4)
    base[:3, 3], away[:3, 3] = [0.4, 0.0, 1.0], [1.4, 0.0, 0.5875]
    scene.place(base, pose, away, 0.5)
    scene.set_gains(config.env.action, config.env.action.kp_position, 0.0)
    target = np.concatenate([np.zeros(6), pose])
    scene.set_target(target)
    for _ in range(20):
        scene.advance(config.physics.substeps)
    gc, _, _, _ = scene.read()
    scene.close()
    # The wrist sags under its weight, mass * g / kp; fingers of grams stay within a degree or two.
    assert np.abs(gc[6:] - pose).max() < 0.05
    assert -0.06 < gc[2] < 0.0 and np.abs(gc[:2]).max() < 0.01


def test_training_runs_on_a_built_hand(place: Path, right: NamedHand, tmp_path: Path) -> None:
    label = dataclasses.replace(make_label(right.model), hand=right.model.id)
    write_native(tmp_path / "own.npz", [label], "made up", "MIT", MANO_NAMES)
    words = ["--cfg", "cfg/dexycb.yaml", "--data", "free", "--run", str(tmp_path / "run"), f"hand={place / 'right'}",
             f"labels.source={tmp_path / 'own.npz'}", "ppo.epochs=1", "env.episode_steps=6", "env.grasp_steps=3",
             "eval.window_s=0.1", "pool.kind=serial", "ppo.hidden=[8]"]
    assert run_command("train", words) == 0
    stamp = json.loads((tmp_path / "run" / "data.json").read_text())
    assert stamp["hand"] == right.model.id and not stamp["comparable_with_paper"]


def test_labels_of_another_hand_are_refused(place: Path, right: NamedHand, left: NamedHand, tmp_path: Path) -> None:
    label = dataclasses.replace(make_label(right.model), hand=right.model.id)
    write_native(tmp_path / "right.npz", [label], "made up", "MIT", MANO_NAMES)
    write_native(tmp_path / "left.npz", [mirror_label(label, left.model.id)], "made up", "MIT", MANO_NAMES)

    def choose(hand: str, labels: str) -> str:
        values = {"data": "free", "hand": str(place / hand), "labels": {"source": str(tmp_path / labels)}}
        return resolve(make_config(values)).hand

    assert choose("right", "right.npz") == right.model.id
    assert choose("right/hand.urdf", "right.npz") == right.model.id
    assert choose("left", "left.npz") == left.model.id
    with pytest.raises(DataError, match="labels made for the hand"):
        choose("right", "left.npz")
    with pytest.raises(DataError, match="labels made for the hand 'free'"):
        resolve(make_config({"data": "free", "hand": str(place / "right")}))


def test_a_hand_that_was_changed_is_refused(place: Path, tmp_path: Path) -> None:
    for name, edit in (("hand.urdf", lambda t: t.replace('upper="2"', 'upper="3"', 1)),
                       ("palm_hull.obj", lambda t: t + "# seen\n"), ("hand.json", lambda t: t.replace("-", "-0", 1)),
                       ("hand.json", lambda t: t[:50]), ("hand.json", lambda t: "[]"),
                       ("hand.json", lambda t: t.replace('"parts"', '"pears"'))):
        folder = tmp_path / "hand"
        shutil.copytree(place / "left", folder)
        assert open_hand(str(folder)).model.id.startswith("mano_left-")
        text = (folder / name).read_text()
        assert edit(text) != text
        (folder / name).write_text(edit(text))
        with pytest.raises(DataError, match=r"built|build"):
            built_hand(folder)
        shutil.rmtree(folder)
    shutil.copytree(place / "left", tmp_path / "hand")
    (tmp_path / "hand" / "index_distal_hull.obj").unlink()
    with pytest.raises(DataError, match="index_distal_hull"):
        open_hand(str(tmp_path / "hand"))


def test_the_same_model_gives_the_same_bytes(place: Path, tmp_path: Path) -> None:
    words = ["--mano", str(place / "MANO_RIGHT.pkl"), "--betas", "0.5", "-0.3", "--side", "left", "--shapes", "hulls"]
    assert run_command("hand build", [*words, "--out", str(tmp_path / "again")]) == 0
    for file in (place / "left").iterdir():
        assert (tmp_path / "again" / file.name).read_bytes() == file.read_bytes(), file.name


def test_limits_of_labels(place: Path, right: NamedHand, tmp_path: Path) -> None:
    label = dataclasses.replace(make_label(right.model, flexion=0.6), hand=right.model.id)
    write_native(tmp_path / "l.npz", [label], "made up", "MIT", MANO_NAMES)
    words = ["--mano", str(place / "MANO_RIGHT.pkl"), "--shapes", "hulls", "--limits", str(tmp_path / "l.npz")]
    assert run_command("hand build", [*words, "--out", str(tmp_path / "a")]) == 0
    found = open_hand(str(tmp_path / "a"))
    assert np.abs(found.model.limits[6:] - label_limits([label])).max() < 1e-6
    assert found.meta["limits"].startswith("range of l.npz")


def test_bad_input_of_the_command(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(place / "MANO_RIGHT.pkl")
    cases = [
        (["--mano", str(tmp_path / "none.pkl"), "--out", str(tmp_path / "x")], "cannot be read"),
        (["--mano", file, "--out", str(place / "right")], "exists already"),
        (["--mano", file, "--out", str(tmp_path / "x"), "--betas", *["1"] * 11], "at most 10"),
        (["--mano", file, "--out", str(tmp_path / "x"), "--betas", "99"], "few units"),
        (["--mano", file, "--out", str(tmp_path / "x"), "--betas", "-19"], "expected"),
        (["--mano", file, "--out", str(tmp_path / "x"), "--betas", "1", "b"], "expected numbers"),
        (["--mano", file, "--out", str(tmp_path / "x"), "--betas", str(tmp_path / "b.yml")], "cannot be read"),
        (["--mano", file, "--out", str(tmp_path / "x"), "--limits", str(tmp_path / "l.npz")], "no such label file"),
        (["--mano", file, "--out", str(place / "MANO_RIGHT.pkl" / "x")], "cannot be written"),
    ]
    for words, message in cases:
        assert main(["hand", "build", *words]) == 2, words
        assert message in capsys.readouterr().err, words
    assert not (tmp_path / "x").exists() and list(tmp_path.iterdir()) == []


def test_report(place: Path, right: NamedHand, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hand", "report", str(place / "right"), "free"]) == 0
    shown = capsys.readouterr().out
    assert right.model.id in shown and "little_distal" in shown and "thumb_tip" in shown
    assert main(["hand", "report", "nowhere"]) == 2
    assert 'expected "free"' in capsys.readouterr().err
    assert main(["hand", "rebuild"]) == 2
    assert "did you mean 'hand build'?" in capsys.readouterr().err
    assert main(["hand", "--help"]) == 0
