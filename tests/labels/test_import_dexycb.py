"""`dgrasp labels import dexycb` on a small data set in its layout, with answers that follow from how it was written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dgrasp.cli import main
from dgrasp.hand.mano.params import ManoParams
from dgrasp.hand.mano.skeleton import PARTS
from dgrasp.labels.formats.native import read_native, read_native_with_meta
from dgrasp.labels.recorded.dexycb import find_sequences, read_sequence
from dgrasp.labels.recorded.dexycb_grasps import split_sequences
from dgrasp.types import GraspLabel
from tests.labels.mini_dexycb import FRAMES, MiniDexYcb, approach, standard
from tests.labels.mini_hand import write_mini_hand

OUT = "labels.npz"


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DGRASP_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("DEX_YCB_DIR", raising=False)
    return tmp_path / "cache"


@pytest.fixture
def hand(mini: MiniDexYcb) -> Path:
    """A hand with the joints of the made-up MANO file, mean shape."""
    return write_mini_hand(mini.root / "mini_hand.urdf", mini.model)


def run(mini: MiniDexYcb, hand: Path, *options: str) -> list[GraspLabel]:
    """Import the data set by the command line and read the labels back."""
    out = mini.root / OUT
    words = ["--mano", str(mini.root / "MANO_RIGHT.pkl"), "--hand", str(hand), "--out", str(out), *options]
    assert main(["labels", "import", "dexycb", str(mini.root), *words]) == 0
    return read_native(out)


def test_known_answers(mini: MiniDexYcb, hand: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mini.add("20200709-subject-01", "20200709_141754", standard())
    (label,) = run(mini, hand)
    assert (label.object_id, label.index, label.on_table) == ("004_sugar_box", 0, True)
    assert label.source == "dexycb:20200709-subject-01/20200709_141754"
    # Frame 22 is the first beyond 10 mm: the object 12 mm above (0.6, 0.2, 0.1) on a table whose top is at 0.5.
    np.testing.assert_allclose(label.T_WO[:3, 3], [0.6, 0.2, 0.612], atol=1e-6)
    np.testing.assert_allclose(label.T_WO[:3, :3], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(label.T_WH[:3, 3], [0.788, 0.2, 0.612], atol=1e-6)
    np.testing.assert_allclose(label.T_WH[:3, :3], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(label.hand_pose, 0.0, atol=1e-6)
    # Frame 16 is the first within 0.2 m: 0.188 + 4 * 0.0025, and the object still lies.
    assert label.start is not None
    np.testing.assert_allclose(label.start.T_WH[:3, 3], [0.798, 0.2, 0.6], atol=1e-6)
    np.testing.assert_allclose(label.start.T_WO[:3, 3], [0.6, 0.2, 0.6], atol=1e-6)
    # The box ends at x = 0.02. The middle fingertip reaches to 0.188 - 0.1603 = 0.0277, 8 mm from it; the index and
    # the ring finger, which end at -0.1508, stay 17 mm away.
    assert [PARTS[i] for i in np.flatnonzero(label.goal_contacts)] == ["middle_distal"]
    # The key points are those of the mean shape at the zero pose: its middle fingertip, seen from its wrist.
    vertices, joints = mini.model.shaped(np.zeros(0))
    tip = vertices[mini.model.tip_vertices[1]] - joints[0]
    np.testing.assert_allclose(label.joints_W[8] - label.joints_W[0], tip, atol=1e-6)
    shown = capsys.readouterr().out
    assert "1 sequences, 1 in the split all (seed 1); 1 labels, 0 results from the cache" in shown
    assert "CC BY-NC" in shown and "004_sugar_box 1" in shown


def test_the_labels_go_on_to_be_checked(mini: MiniDexYcb, hand: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mini.add("s1", "a", standard())
    run(mini, hand)
    assert main(["labels", "check", str(mini.root / OUT), "--data", "free", "--hand", str(hand)]) == 0
    shown = capsys.readouterr().out
    assert "hand mini_hand" in shown and "1 labels of 1 objects: 1 with an approach, 1 with a table" in shown
    # The object's origin is 0.1 m above the table, half of the box's height is 0.0875.
    assert "the objects' lowest points are +12.5 to +12.5 mm above the table's top" in shown
    # And the mini hand is cubes around its joints, which end farther from the box than its skin.
    assert "dexycb:s1/a:004_sugar_box[0]: hand 29 mm from the object; object 13 mm over the table" in shown


def test_poses_are_found_again(mini: MiniDexYcb, hand: Path) -> None:
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(3)
    R_TH, R_TO = Rotation.random(2, random_state=rng).as_matrix()
    pose = rng.uniform(-0.4, 0.4, 45)
    mini.add("s1", "a", standard(R_TH=R_TH, R_TO=R_TO, pose=pose))
    (label,) = run(mini, hand)
    np.testing.assert_allclose(label.T_WH[:3, :3], R_TH, atol=2e-6)
    np.testing.assert_allclose(label.T_WO[:3, :3], R_TO, atol=2e-6)
    # Back to MANO's parameters: its pose, and its translation J0 + t = wrist.
    betas = np.array([mini.betas["s1_right"]])
    back = ManoParams.of(mini.model, betas, label.T_WH[None], label.hand_pose[None])
    np.testing.assert_allclose(back.pose[0], pose, atol=2e-6)
    J0 = (mini.model.J_regressor @ mini.model.shaped(betas[0])[0])[0]
    np.testing.assert_allclose(back.transl[0] + J0, label.T_WH[:3, 3], atol=1e-12)


def test_several_subjects_and_what_is_skipped(
    mini: MiniDexYcb, hand: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrist, place = approach()
    mini.add("s1", "a", standard())
    # Another shape: the wrist is where it was recorded all the same, for J0 follows the betas.
    mini.add("s2", "b", standard(object=21))
    # The grasp is the first frame with both annotated: 23, the object 16 mm up.
    mini.add("s2", "c", standard(hidden_hand=(21, 22), hidden_object=(0, 1)))
    # First seen at 0.1955 m, so its approach was not recorded.
    mini.add("s2", "d", standard(hidden_hand=tuple(range(17))))
    mini.add("s2", "e", standard(hidden_hand=tuple(range(FRAMES))))
    mini.add("s3", "f", standard(hidden_object=tuple(range(FRAMES))))
    mini.add("s3", "g", standard(place=np.tile(place[0], (FRAMES, 1))))
    mini.add("s3", "h", standard(hidden_hand=tuple(range(22, FRAMES))))
    mini.add("s3", "i", standard(wrist=wrist + np.array([0.3, 0.0, 0.0])))
    mini.add("s3", "j", standard(side="left"))
    mini.add("s3", "k", standard(object=19))
    damaged = mini.add("s3", "l", standard())
    (damaged / "pose.npz").write_bytes(b"PK")
    labels = run(mini, hand)
    assert [(label.source[7:], label.object_id, label.index) for label in labels] == [
        ("s1/a", "004_sugar_box", 0), ("s2/c", "004_sugar_box", 1), ("s2/d", "004_sugar_box", 2),
        ("s2/b", "061_foam_brick", 0),
    ]  # fmt: skip
    for label in (labels[0], labels[3]):
        np.testing.assert_allclose(label.T_WH[:3, 3], [0.788, 0.2, 0.612], atol=1e-6)
    assert labels[1].T_WO[2, 3] == pytest.approx(0.616, abs=1e-6)
    assert labels[2].start is None and labels[1].start is not None
    shown = capsys.readouterr().out
    assert "labels without an approach, because the hand was first seen closer than 0.2 m: 1" in shown
    _, meta = read_native_with_meta(mini.root / OUT)
    assert meta["provenance"]["skipped"] == {
        "s3/j": "left hand", "s2/e": "hand not annotated", "s3/f": "object not annotated",
        "s3/g": "object not moved beyond the threshold", "s3/h": "hand not annotated once the object has moved",
        "s3/i": "wrist far from the object at the grasp", "s3/k": "damaged or missing file",
        "s3/l": "damaged or missing file",
    }  # fmt: skip
    assert "skipped 2: damaged or missing file: s3/k" in shown and "expected DexYCB ids" in shown
    assert "skipped 1: left hand: s3/j" in shown


def test_a_tag_that_faces_down_is_turned(
    mini: MiniDexYcb, hand: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mini.add("s1", "a", standard(), tag="down")
    (label,) = run(mini, hand)
    assert "tags whose z axis points into the table (turned about x): 1" in capsys.readouterr().out
    run(mini, hand)
    shown = capsys.readouterr().out
    assert "1 results from the cache" in shown and "(turned about x): 1" in shown
    # Its y and z are reversed; turned about its x, it is the upright tag again.
    np.testing.assert_allclose(label.T_WO[:3, 3], [0.6, 0.2, 0.612], atol=1e-6)


def test_left_hands_in_the_mirror(mini: MiniDexYcb, hand: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrist, place = approach()
    # A left hand's fingers point along +x: it comes from the other side.
    left = standard(side="left", wrist=2 * place - wrist)
    mini.add("s1", "a", left)
    mini.mesh("061_foam_brick", (-0.02, -0.02, -0.02), (0.02, 0.02, 0.02))
    mesh = mini.root / "models" / "061_foam_brick" / "textured_simple.obj"
    # A corner cut off along a diagonal: no plane across an axis leaves it as it is.
    mesh.write_text("v 0 0 0\nv .06 0 0\nv 0 .09 0\nv 0 0 .12\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    mini.add("s1", "b", standard(side="left", wrist=2 * place - wrist, object=21))
    (label,) = run(mini, hand, "--mirror-left", str(mini.root / "MANO_LEFT.pkl"))
    assert "skipped 1: object is not its own mirror image: s1/b (061_foam_brick: off by" in capsys.readouterr().out
    # y of the world changes sign; x -> -x in the wrist's and in the box's frame keeps both right-handed.
    np.testing.assert_allclose(label.T_WO[:3, 3], [0.6, -0.2, 0.612], atol=1e-6)
    np.testing.assert_allclose(label.T_WH[:3, 3], [0.412, -0.2, 0.612], atol=1e-6)
    np.testing.assert_allclose(label.T_WH[:3, :3], np.diag([-1.0, -1.0, 1.0]), atol=1e-6)
    np.testing.assert_allclose(label.T_WO[:3, :3], np.diag([-1.0, -1.0, 1.0]), atol=1e-6)
    assert [PARTS[i] for i in np.flatnonzero(label.goal_contacts)] == ["middle_distal"]
    # The right hand's tip points to the object.
    assert label.joints_W[8, 0] > label.joints_W[0, 0] + 0.15


def test_the_mirror_plane_of_an_object_off_its_origin(mini: MiniDexYcb, hand: Path) -> None:
    wrist, place = approach()
    # The box is at 0.10 to 0.14 of its frame's x, so its middle is 0.12 from the origin that the poses name.
    mini.mesh("004_sugar_box", (0.10, -0.045, -0.0875), (0.14, 0.045, 0.0875))
    shift = np.array([0.12, 0.0, 0.0])
    mini.add("s1", "a", standard(side="left", wrist=2 * place - wrist, place=place - shift))
    (label,) = run(mini, hand, "--mirror-left", str(mini.root / "MANO_LEFT.pkl"), "--start-distance", "0.4")
    middle = label.T_WO[:3, :3] @ shift + label.T_WO[:3, 3]
    np.testing.assert_allclose(middle, [0.6, -0.2, 0.612], atol=1e-6)
    assert [PARTS[i] for i in np.flatnonzero(label.goal_contacts)] == ["middle_distal"]


def test_the_cache(mini: MiniDexYcb, hand: Path, own_cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = mini.add("s1", "a", standard())
    mini.add("s1", "b", standard(hidden_hand=tuple(range(FRAMES))))
    first = run(mini, hand)
    raw = (mini.root / OUT).read_bytes()
    assert len(list((own_cache / "labels").iterdir())) == 2
    run(mini, hand)
    assert (mini.root / OUT).read_bytes() == raw
    assert "1 labels, 2 results from the cache" in capsys.readouterr().out
    # Another threshold, another recording, another mesh: other labels.
    assert run(mini, hand, "--displacement", "0.013")[0].T_WO[2, 3] == pytest.approx(0.616, abs=1e-6)
    assert "0 results from the cache" in capsys.readouterr().out
    mini.mesh("004_sugar_box", (-0.02, -0.045, -0.0875), (0.03, 0.045, 0.0875))
    # 10 mm longer: now index and ring fingertips, at 17 mm before, are near as well.
    (label,) = run(mini, hand)
    assert [PARTS[i] for i in np.flatnonzero(label.goal_contacts)] == ["index_distal", "middle_distal", "ring_distal"]
    assert not np.array_equal(label.goal_contacts, first[0].goal_contacts)
    # Damaged entries are made anew.
    for file in (own_cache / "labels").iterdir():
        file.write_text(file.read_text()[:40])
    (folder / "extra.txt").write_text("does not matter")
    assert np.array_equal(run(mini, hand)[0].goal_contacts, label.goal_contacts)


def test_the_split(mini: MiniDexYcb, hand: Path) -> None:
    for subject in ("s1", "s2"):
        for k in range(4):
            mini.add(subject, f"q{k}", standard())
    train, test = run(mini, hand, "--split", "train"), run(mini, hand, "--split", "test")
    # Three of every four, in each subject.
    for subject in ("s1", "s2"):
        assert sum(subject in label.source for label in train) == 3
        assert sum(subject in label.source for label in test) == 1
    assert len({label.source for label in [*train, *test]}) == 8
    sequences = [read_sequence(folder) for folder in find_sequences(mini.root)]
    splits = [split_sequences(sequences, "test", seed) for seed in range(20)]
    assert splits[1] == {label.source[7:] for label in test} == split_sequences(sequences[::-1], "test", 1)
    assert len({frozenset(names) for names in splits}) > 5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["/nowhere"], "no DexYCB here"),
        ([], "DEX_YCB_DIR is not set"),
        (["{root}", "--displacement", "0"], "--displacement 0: expected metres"),
        (["{root}", "--start-distance", "nan"], "--start-distance nan"),
        (["{root}", "--seed", "-1"], "--seed -1"),
        (["{root}", "--mano", "{root}/MANO_LEFT.pkl"], "a right hand, but the MANO file is of a left one"),
        (["{root}", "--mirror-left", "{root}/MANO_RIGHT.pkl"], "expected MANO_LEFT.pkl"),
        (["{root}", "--hand", "free"], "its joints lie up to"),
        (["{root}", "--out", "{root}/labels.pkl"], "expected the name of a .npz file"),
        (["{root}"], "no label is left"),
    ],
)
def test_wrong_use(
    mini: MiniDexYcb, hand: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mini.add("s1", "a", standard(hidden_hand=tuple(range(FRAMES))))
    defaults = ["--mano", str(mini.root / "MANO_RIGHT.pkl"), "--hand", str(hand), "--out",
                str(mini.root / OUT)]
    filled = [word.replace("{root}", str(mini.root)) for word in words]
    assert main(["labels", "import", "dexycb", *defaults, *filled]) == 2
    assert message in capsys.readouterr().err
    assert not (mini.root / OUT).exists()
