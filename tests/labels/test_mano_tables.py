"""Tables of MANO parameters: conventions are given or found, and the way back to the parameters is exact."""

from __future__ import annotations

import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.cli import main
from dgrasp.errors import DataError
from dgrasp.hand.mano.params import ManoParams, hand_vertices, wrist_joints
from dgrasp.hand.mano.pose import to_pca
from dgrasp.labels.formats.native import read_native, read_native_with_meta
from dgrasp.labels.recorded.conventions import CHOICES, read_grasps
from dgrasp.labels.recorded.mano_table import read_mano_table
from dgrasp.scene.standing import PLACE_XY
from dgrasp.types import Array
from tests.labels.mini_dexycb import MiniDexYcb, make_mini
from tests.labels.mini_hand import write_mini_hand

N = 4
GIVEN = {"pose": "axis-angle", "mean": "flat", "fingers": "mano", "transl": "mano", "quaternion": "wxyz"}


@pytest.fixture
def mini(tmp_path: Path) -> MiniDexYcb:
    return make_mini(tmp_path / "dex")[0]


def grasps(mini: MiniDexYcb, seed: int = 0) -> tuple[ManoParams, Array, Array]:
    """Hands that reach into a box, as parameters in frame A, the boxes' poses T_AO, and the poses of hands in O."""
    rng = np.random.default_rng(seed)
    T_AO, T_OH = np.tile(np.eye(4), (2, N, 1, 1))
    T_AO[:, :3, :3] = Rotation.random(N, random_state=rng).as_matrix()
    T_AO[:, :3, 3] = rng.uniform(-1, 1, (N, 3))
    T_OH[:, :3, 3] = [0.15, 0.0, 0.0]
    betas, pose = rng.normal(size=(N, 10)), rng.uniform(-0.4, 0.4, (N, 45))
    T_AH = T_AO @ T_OH
    orient = Rotation.from_matrix(T_AH[:, :3, :3]).as_rotvec()
    return ManoParams(orient, pose, T_AH[:, :3, 3] - wrist_joints(mini.model, betas), betas), T_AO, T_OH


def table(mini: MiniDexYcb, answers: dict[str, str], seed: int = 0) -> dict[str, Any]:
    """The arrays of a file that follows `answers`."""
    params, T_AO, _ = grasps(mini, seed)
    model, transl = mini.model, params.transl
    if answers["pose"] == "pca":
        pose = to_pca(model, params.pose, flat_hand_mean=answers["mean"] == "flat")
    else:
        pose = params.pose - (model.hands_mean if answers["mean"] == "mano" else 0.0)
        if answers["fingers"] == "project":
            # MANO lists index, middle, little, ring, thumb: the third and the fourth change places.
            pose = pose.reshape(N, 5, 9)[:, [0, 1, 3, 2, 4]].reshape(N, 45)
    if answers["transl"] == "wrist":
        transl = transl + wrist_joints(model, params.betas)
    quaternion = Rotation.from_matrix(T_AO[:, :3, :3]).as_quat()
    quaternion = quaternion[:, [3, 0, 1, 2]] if answers["quaternion"] == "wxyz" else quaternion
    return {
        "object": np.array(["004_sugar_box", "061_foam_brick"] * (N // 2)), "betas": params.betas,
        "global_orient": params.orient, "hand_pose": pose, "transl": transl, "object_rotation": quaternion,
        "object_translation": T_AO[:, :3, 3],
    }  # fmt: skip


def write_csv(path: Path, arrays: dict[str, Any]) -> Path:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        names = [f"{k}_{i}" for k, v in arrays.items() if k != "object" for i in range(v.shape[1])]
        writer.writerow(["object", *names])
        for row in range(N):
            numbers = [repr(float(x)) for k, v in arrays.items() if k != "object" for x in v[row]]
            writer.writerow([arrays["object"][row], *numbers])
    return path


def write_npz(path: Path, arrays: dict[str, Any]) -> Path:
    np.savez(path, **arrays)
    return path


def import_file(mini: MiniDexYcb, file: Path, *options: str) -> int:
    hand = write_mini_hand(mini.root / "mini_hand.urdf", mini.model)
    return main(["labels", "import", "mano", str(file), "--mano", str(mini.root / "MANO_RIGHT.pkl"), "--hand",
                 str(hand), "--objects", str(mini.root / "models"), "--out", str(mini.root / "out.npz"), *options])


def words(answers: dict[str, str]) -> list[str]:
    return [word for question, answer in answers.items() for word in (f"--{question}", answer)]


@pytest.mark.parametrize("kind", ["npz", "csv"])
def test_a_file_becomes_labels(mini: MiniDexYcb, tmp_path: Path, kind: str) -> None:
    arrays = table(mini, GIVEN)
    file = (write_npz if kind == "npz" else write_csv)(tmp_path / f"a.{kind}", arrays)
    assert import_file(mini, file, *words(GIVEN)) == 0
    labels, meta = read_native_with_meta(mini.root / "out.npz")
    params, T_AO, T_OH = grasps(mini)
    # By object: rows 0 and 2 are of the sugar box, 1 and 3 of the foam brick.
    assert [(label.object_id[:3], label.index, label.source) for label in labels] == [
        ("004", 0, f"a.{kind}:0"), ("004", 1, f"a.{kind}:2"), ("061", 0, f"a.{kind}:1"), ("061", 1, f"a.{kind}:3"),
    ]
    for label, row in zip(labels, (0, 2, 1, 3), strict=True):
        assert label.start is None and not label.on_table and label.hand == "mini_hand"
        # The world is the object's frame.
        np.testing.assert_array_equal(label.T_WO, np.eye(4))
        np.testing.assert_allclose(label.T_WH, T_OH[row], atol=1e-9)
        # And back: the label in the file's frame has the file's parameters.
        T_AH = (T_AO[row] @ label.T_WH)[None]
        back = ManoParams.of(mini.model, params.betas[row : row + 1], T_AH, label.hand_pose[None])
        for name in ("orient", "pose", "transl"):
            np.testing.assert_allclose(getattr(back, name)[0], getattr(params, name)[row], atol=1e-6)
    assert meta["provenance"]["conventions"]["quaternion"] == "wxyz (given)"


def test_a_table_and_its_height(mini: MiniDexYcb, tmp_path: Path) -> None:
    file = write_npz(tmp_path / "a.npz", table(mini, GIVEN))
    assert import_file(mini, file, *words(GIVEN), "--table", "-0.25") == 0
    _, T_AO, T_OH = grasps(mini)
    label = read_native(mini.root / "out.npz")[1]
    # The top goes from z = -0.25 to 0.5: all rises by 0.75. The object comes to stand where all do.
    shift = np.array([*(np.array(PLACE_XY) - T_AO[2, :2, 3]), 0.75])
    expected = T_AO[2].copy()
    expected[:3, 3] += shift
    np.testing.assert_allclose(label.T_WO, expected, atol=1e-12)
    np.testing.assert_allclose(label.T_WO[:2, 3], PLACE_XY, atol=1e-12)
    np.testing.assert_allclose(label.T_WH, expected @ T_OH[2], atol=1e-9)
    assert label.on_table


ALL = [dict(zip(CHOICES, answers, strict=True)) for answers in itertools.product(*CHOICES.values())
       if not (answers[0] == "pca" and answers[2] == "project")]


@pytest.mark.parametrize("answers", ALL, ids=["-".join(a.values()) for a in ALL])
def test_every_convention_given_or_found(mini: MiniDexYcb, tmp_path: Path, answers: dict[str, str]) -> None:
    arrays = table(mini, answers)
    params, T_AO, T_OH = grasps(mini)
    T_AH = T_AO @ T_OH
    coordinates = params.coordinates(mini.model)
    found = read_grasps(read_mano_table(write_npz(tmp_path / "a.npz", arrays)), mini.model, answers, False, False)
    # The key points in an order of their own, as other software lists them.
    points = hand_vertices(mini.model, params.betas, *coordinates)[1][:, ::-1]
    file = write_npz(tmp_path / "b.npz", {**arrays, "joints": points})
    quaternion = {"quaternion": answers["quaternion"]}
    detected = read_grasps(read_mano_table(file), mini.model, quaternion, False, False)
    for one in (found, detected):
        np.testing.assert_allclose(one.T_AH, T_AH, atol=1e-9)
        np.testing.assert_allclose(one.hand_pose, coordinates[1], atol=1e-9)
        np.testing.assert_allclose(one.T_AO, T_AO, atol=1e-9)
    assert detected.answers["transl"] == f"{answers['transl']} (found by the key points)"
    if answers["pose"] == "axis-angle":
        assert detected.answers["fingers"].startswith(answers["fingers"])


def test_few_coefficients_are_pca(mini: MiniDexYcb, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    few = rng.normal(size=(N, 15))
    arrays = table(mini, GIVEN) | {"hand_pose": few}
    file = read_mano_table(write_npz(tmp_path / "a.npz", arrays))
    found = read_grasps(file, mini.model, {"mean": "mano", "transl": "mano", "quaternion": "wxyz"}, False, False)
    expected = mini.model.hands_mean + few @ mini.model.hands_components[:15]
    back = ManoParams.of(mini.model, arrays["betas"], found.T_AH, found.hand_pose)
    same = Rotation.from_rotvec(back.pose.reshape(-1, 3)).as_matrix()
    # Vectors beyond pi come back as the same rotation the other way round.
    np.testing.assert_allclose(same, Rotation.from_rotvec(expected.reshape(-1, 3)).as_matrix(), atol=1e-9)
    assert found.answers["pose"] == "pca (implied)" and found.answers["mean"] == "mano (given)"
    with pytest.raises(DataError, match="--pose axis-angle contradicts the data, which is pca"):
        read_grasps(file, mini.model, {**GIVEN}, False, False)


def test_graspttas_vector_and_contactopts_transform(mini: MiniDexYcb, tmp_path: Path) -> None:
    arrays = table(mini, GIVEN)
    params, _, T_OH = grasps(mini)
    # In the objects' frame, the objects at its origin, shape, turn, pose and translation in one vector.
    transl = T_OH[:, :3, 3] - wrist_joints(mini.model, params.betas)
    vector = np.concatenate([params.betas, np.zeros((N, 3)), params.pose, transl], axis=1)
    assert vector.shape == (N, 61)
    file = write_npz(tmp_path / "a.npz", {"object": arrays["object"], "params": vector})
    options = ["--object-at-origin", *words({k: v for k, v in GIVEN.items() if k != "quaternion"})]
    assert import_file(mini, file, *options) == 0
    np.testing.assert_allclose(read_native(mini.root / "out.npz")[0].T_WH, T_OH[0], atol=1e-9)
    # The same hand, made at MANO's own place and moved there as a mesh by (R, t).
    R = Rotation.from_euler("xyz", [0.3, -0.8, 1.2]).as_matrix()
    moved = np.tile(np.eye(4), (N, 1, 1))
    moved[:, :3, :3] = R
    J0 = wrist_joints(mini.model, params.betas)
    # The wrist, at J0 + 0 before, comes to R J0 + t = its place.
    moved[:, :3, 3] = T_OH[:, :3, 3] - J0 @ R.T
    orient = np.tile(Rotation.from_matrix(R.T).as_rotvec(), (N, 1))
    file = write_npz(tmp_path / "b.npz", {
        "object": arrays["object"], "betas": params.betas, "global_orient": orient, "hand_pose": params.pose,
        "transl": np.zeros((N, 3)), "hand_transform": moved,
    })  # fmt: skip
    assert import_file(mini, file, *options) == 0
    np.testing.assert_allclose(read_native(mini.root / "out.npz")[0].T_WH, T_OH[0], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({}, {"pose": ""}, "the table does not say what its numbers mean; give --pose pca|axis-angle"),
        ({}, {"mean": "", "transl": ""}, "give --mean flat|mano, --transl mano|wrist"),
        ({}, {"fingers": ""}, "give --fingers mano|project"),
        ({}, {"quaternion": ""}, "give --quaternion wxyz|xyzw"),
        ({}, {"pose": "pca", "fingers": "project"}, "contradict each other"),
        ({"joints": np.zeros((N, 21, 3))}, {}, "the key points `joints` lie up to"),
        ({"transl": np.full((N, 3), np.nan)}, {}, "row 0: transl holds NaN"),
        ({"transl": np.zeros((N, 2))}, {}, "transl has 2 numbers per row; expected 3"),
        ({"transl": np.zeros((N - 1, 3))}, {}, "rows per quantity"),
        ({"translation": np.zeros((N, 3))}, {}, "unknown or duplicate member 'translation.npy'"),
        ({"object": np.array(["004_sugar_bx"] * N)}, {}, "did you mean '004_sugar_box'"),
        ({"object": np.array(["004_sugar_box"] * 3)}, {}, "3 names of objects for 4 rows"),
        ({"object_rotation": np.full((N, 4), 1.0)}, {}, "not of length 1"),
        ({"object_rotation": np.zeros((N, 3, 3))}, {}, "not a rigid transform"),
        ({"object_translation": np.full((N, 3), 500.0)}, {}, "beyond 10 m"),
        ({"params": np.zeros((N, 61))}, {}, "has params and also betas"),
        ({"betas": None}, {}, "no betas"),
        ({"hand_pose": None}, {}, "no hand_pose"),
        ({"object_rotation": None}, {}, "no object_rotation"),
        ({"object": None}, {}, "with --object"),
        ({"betas": np.full((N, 10), 50.0)}, {}, "a.npz: betas beyond 20"),
        ({"object_translation": np.full((N, 3), 9.0)}, {}, "m from its origin"),
    ],
)  # fmt: skip
def test_what_is_refused(
    mini: MiniDexYcb, tmp_path: Path, change: dict[str, Any], options: dict[str, str], message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    arrays = {key: value for key, value in (table(mini, GIVEN) | change).items() if value is not None}
    file = write_npz(tmp_path / "a.npz", arrays)
    given = {key: value for key, value in (GIVEN | options).items() if value}
    assert import_file(mini, file, *words(given)) == 2
    printed = capsys.readouterr()
    assert message in printed.err + printed.out
    assert not (mini.root / "out.npz").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("object,transl_0,transl_2\n004,1,2\n", "the columns of transl are not numbered from 0 to 1"),
        ("object,transl_0,transl_0\n", "unknown or duplicate column 'transl_0'"),
        ("object,x\n", "unknown or duplicate column 'x'"),
        ("object,transl_0,transl_1,transl_2\n004,1,2\n", "line 2: 3 cells; expected 4"),
        ("object,transl_0,transl_1,transl_2\n004,1,2,y\n", "line 2: could not convert string to float"),
        ("object,transl_0,transl_1,transl_2\n004,1,2,inf\n", "row 0: transl holds NaN, infinity"),
        ("object,transl_0,transl_1,transl_2\n", "rows per quantity"),
        ("", "rows per quantity"),
        ("\0\0", "expected arrays or columns"),
        ('object,transl_0\n"004', "neither .npz nor .csv"),
    ],
)
def test_bad_csv(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DataError) as caught:
        read_mano_table(tmp_path / "a.csv")
    assert message in str(caught.value) and str(tmp_path / "a.csv") in str(caught.value)


CSV = "object,transl_0,transl_1,transl_2,betas_0\n004,0.5,-1.25e-1,2,0\n061,1,2.5,3,-0.75\n"
GERMAN = CSV.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    "raw",
    [
        CSV.encode(), CSV.replace("\n", "\r\n").encode("utf-8-sig"), CSV.encode("utf-16"), GERMAN.encode(),
        GERMAN.encode("utf-16"), CSV.replace(",", "\t").encode(), CSV.replace(",", ";").encode(),
        ("sep=;\r\n" + GERMAN).encode(), CSV.replace(",", "\t").replace(".", ",").encode("utf-8-sig"),
        b",object,transl_0,transl_1,transl_2,betas_0\n0,004,0.5,-1.25e-1,2,0\n1,061,1,2.5,3,-0.75\n",
        b"Unnamed: 0;object;transl_0;transl_1;transl_2;betas_0\n0;004;0,5;-1,25e-1;2;0\n1;061;1;2,5;3;-0,75\n",
        b'"object","transl_0","transl_1","transl_2","betas_0"\n"004","0.5","-0.125","2","0"\n\n'
        b"061, 1, 2.5, 3, -0.75\n,,,,\n",
        b'object,transl_0,transl_1,transl_2,betas_0\n004,"0,5","-1,25e-1",2,0\n061,1,"2,5",3,"-0,75"\n',
    ],
    ids=range(13),
)  # fmt: skip
def test_csv_of_spreadsheets_and_pandas(tmp_path: Path, raw: bytes) -> None:
    (tmp_path / "a.csv").write_bytes(raw)
    found = read_mano_table(tmp_path / "a.csv")
    assert found.objects == ["004_sugar_box", "061_foam_brick"]
    np.testing.assert_array_equal(found.values["transl"], [[0.5, -0.125, 2.0], [1.0, 2.5, 3.0]])
    np.testing.assert_array_equal(found.values["betas"], [[0.0], [-0.75]])


def test_csv_in_windows_encoding(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes("object;transl_0;transl_1;transl_2\ntassé;1;2;3\n".encode("cp1252"))
    assert read_mano_table(tmp_path / "a.csv", known=lambda name: name).objects == ["tassé"]
