"""Files as data sets and estimators write them: `--from` gives the conventions of each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from dgrasp.cli import main
from dgrasp.errors import DataError
from dgrasp.hand.free.skin import free_skin, skin_path
from dgrasp.hand.mano.params import wrist_joints
from dgrasp.labels.formats.native import read_native
from dgrasp.labels.recorded.mano_table import ManoTable, read_mano_table
from dgrasp.labels.recorded.table_sources import TABLE_SOURCES, rotation_vectors
from dgrasp.types import Array

N = 3
OPTIONS = ["--mano", str(skin_path()), "--hand", "free"]


def rotations(seed: int = 0) -> tuple[Array, Array]:
    """Rotation vectors of the wrist (N, 3) and the fingers (N, 45), of angles below pi."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (N, 3)), rng.uniform(-0.5, 0.5, (N, 45))


def matrices(vectors: Array) -> Array:
    """(N, J, 3, 3) of (N, J * 3)."""
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(len(vectors), -1, 3, 3)


def read(path: Path, source: str | None, **arrays: Any) -> ManoTable:
    np.savez(path, **arrays)
    wrote = TABLE_SOURCES[source] if source else None
    return read_mano_table(path, None if "object" in arrays else "004", source=wrote)


def test_rotation_matrices_and_6d(tmp_path: Path) -> None:
    orient, pose = rotations()
    R, fingers = matrices(orient), matrices(pose)
    for turn in (R, R[:, 0]):
        table = read(tmp_path / "a.npz", None, global_orient=turn, hand_pose=fingers)
        np.testing.assert_allclose(table.values["global_orient"], orient, atol=1e-12)
        np.testing.assert_allclose(table.values["hand_pose"], pose, atol=1e-12)
        assert table.matrices
    # Columns: (R00, R10, R20, R01, R11, R21); rows: (R00, R01, R02, R10, R11, R12).
    columns = fingers[..., :2].swapaxes(2, 3).reshape(N, 15, 6)
    table = read(tmp_path / "a.npz", None, global_orient=orient, hand_pose=columns)
    np.testing.assert_allclose(table.values["hand_pose"], pose, atol=1e-12)
    by_rows = fingers[..., :2, :].reshape(N, 90)
    np.testing.assert_allclose(rotation_vectors(by_rows, rows_of_6d=True), pose, atol=1e-12)
    # 6D numbers need be neither of unit length nor at right angles.
    skewed = columns.reshape(N, 15, 2, 3) * 3.0
    skewed[:, :, 1] += 0.4 * skewed[:, :, 0]
    np.testing.assert_allclose(rotation_vectors(skewed.reshape(N, 90), rows_of_6d=False), pose, atol=1e-12)
    # Matrices of three rows and two columns say themselves what they are.
    table = read(tmp_path / "a.npz", None, global_orient=R[..., :2], hand_pose=fingers[..., :2])
    np.testing.assert_allclose(table.values["global_orient"], orient, atol=1e-12)
    np.testing.assert_allclose(table.values["hand_pose"], pose, atol=1e-12)
    with pytest.raises(DataError, match="expected no --rotation6d rows then"):
        read_mano_table(tmp_path / "a.npz", "004", rows_of_6d=True)
    for bad in (fingers * 2.0, -fingers, np.zeros_like(fingers)):
        with pytest.raises(DataError, match="row 0: hand_pose holds a matrix that is no rotation"):
            read(tmp_path / "a.npz", None, global_orient=R, hand_pose=bad)


def test_poses_that_hold_the_wrists_rotation_too(tmp_path: Path) -> None:
    orient, pose = rotations()
    whole = np.concatenate([orient, pose], axis=1)
    R = matrices(whole)
    for form in (whole, whole.reshape(N, 16, 3), R, R.reshape(N, 144), R[..., :2].swapaxes(2, 3).reshape(N, 16, 6),
                 R[..., :2]):
        table = read(tmp_path / "a.npz", None, hand_pose=form)
        np.testing.assert_allclose(table.values["global_orient"], orient, atol=1e-12)
        np.testing.assert_allclose(table.values["hand_pose"], pose, atol=1e-12)
        assert table.matrices == (form.size > whole.size)
    with pytest.raises(DataError, match=r"16 rotations, .* also global_orient"):
        read(tmp_path / "a.npz", None, hand_pose=R, global_orient=orient)
    with pytest.raises(DataError, match="hand_pose has 51 numbers per row; expected 1 to 45, 90 or 135; or, with"):
        read(tmp_path / "a.npz", None, hand_pose=np.zeros((N, 51)))


@pytest.mark.parametrize("source", ["hamer", "wilor"])
def test_estimators(tmp_path: Path, source: str) -> None:
    orient, pose = rotations()
    far = np.tile([0.0, 0.0, 0.7], (N, 1))
    arrays = {"global_orient": matrices(orient), "hand_pose": matrices(pose), "betas": np.zeros((N, 10)),
              "pred_cam_t": far * 9, "pred_cam_t_full": far, "pred_vertices": np.zeros((N, 778, 3)),
              "right": np.ones(N)}
    table = read(tmp_path / "a.npz", source, **arrays)
    np.testing.assert_array_equal(table.values["transl"], far)
    assert set(table.values) == {"global_orient", "hand_pose", "betas", "transl"}
    # The model's whole output, in which they are a dictionary.
    inner = {name: arrays.pop(name) for name in ("global_orient", "hand_pose", "betas")}
    nested = read(tmp_path / "a.npz", source, **arrays, pred_mano_params=np.array(inner, dtype=object))
    for name, values in table.values.items():
        np.testing.assert_array_equal(nested.values[name], values)
    arrays |= inner
    with pytest.raises(DataError, match=r"a\.npz: row 1: right is 0, a left hand"):
        read(tmp_path / "a.npz", source, **{**arrays, "right": np.array([1, 0, 1])})


def test_graspttas_json(tmp_path: Path) -> None:
    params, T = np.arange(61.0)[None] / 100, np.concatenate([np.eye(3), [[0.1], [0.2], [0.3]]], axis=1)
    path = tmp_path / "obj_id_6.json"
    path.write_text(json.dumps({"recon_params": [params.tolist()] * 2, "R_list": [T.tolist()] * 2}))
    table = read_mano_table(path, source=TABLE_SOURCES["grasptta"])
    assert table.objects == ["006_mustard_bottle"] * 2
    np.testing.assert_array_equal(table.values["transl"][0], [0.58, 0.59, 0.60])
    np.testing.assert_array_equal(table.values["object_translation"][1], [0.1, 0.2, 0.3])
    path.write_text("{}")
    with pytest.raises(DataError, match="not GraspTTA's JSON"):
        read_mano_table(path, source=TABLE_SOURCES["grasptta"])


def test_contactopts_names(tmp_path: Path) -> None:
    pose = np.arange(18.0)[None].repeat(N, axis=0) / 10
    table = read(tmp_path / "a.npz", "contactopt", hand_beta=np.zeros((N, 10)), hand_pose=pose,
                 hand_mTc=np.tile(np.eye(4), (N, 1, 1)))
    np.testing.assert_array_equal(table.values["global_orient"][0], [0.0, 0.1, 0.2])
    assert table.values["hand_pose"].shape == (N, 15) and table.values["hand_transform"].shape == (N, 16)
    np.testing.assert_array_equal(table.values["transl"], np.zeros((N, 3)))


def test_a_sequence_of_grab(tmp_path: Path) -> None:
    orient, _ = rotations()
    hand = {"global_orient": orient, "hand_pose": np.zeros((N, 24)), "transl": np.ones((N, 3)),
            "fullpose": np.zeros((N, 45))}
    thing = {"global_orient": orient, "transl": np.zeros((N, 3))}
    table = read(tmp_path / "a.npz", "grab", rhand={"params": hand, "vtemp": "x.ply"}, obj_name="025_mug",
                 object={"params": thing, "object_mesh": "mug.ply"}, body={"params": {}}, n_frames=N)
    assert table.objects == ["025_mug"] * N
    # Its object is turned by row vectors times the matrix: the other way round.
    np.testing.assert_array_equal(table.values["object_rotation"], -orient)
    np.testing.assert_array_equal(table.values["global_orient"], orient)
    with pytest.raises(DataError, match=r"a\.npz: no rhand; expected a sequence of GRAB with its right hand"):
        read(tmp_path / "a.npz", "grab", lhand={"params": hand}, object={"params": thing})


def dexgraspnet(scales: list[float]) -> Array:
    """Grasps of flat hands beside an object at the origin; the wrist 40 mm away in x per 0.1 of scale."""
    J0 = wrist_joints(free_skin(), np.zeros((1, 1)))[0]
    place = (np.array([0.09, 0.0, 0.0]) - J0).tolist()
    qpos = {"trans": place, "rot": [0.0, 0.0, 0.0], "thetas": [0.0] * 45}
    return np.array([{"scale": s, "qpos": qpos, "qpos_st": qpos, "E_fc": 0.1} for s in scales], dtype=object)


def test_dexgraspnets_grasps_and_their_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "meshes" / "my_box").mkdir(parents=True)
    # A cube of unit size: 0.1 of it are 100 mm.
    trimesh.creation.box((1.0, 1.0, 1.0)).export(tmp_path / "meshes" / "my_box" / "textured_simple.obj")
    np.save(tmp_path / "my_box.npy", dexgraspnet([0.1, 0.1, 0.06]), allow_pickle=True)
    out = tmp_path / "out.npz"
    words = ["labels", "import", "mano", str(tmp_path / "my_box.npy"), "--from", "dexgraspnet", "--object", "my_box",
             *OPTIONS, "--objects", str(tmp_path / "meshes"), "--out", str(out)]
    assert main(words) == 2
    assert "grasps at the scales 0.06, 0.1; an object has one size: choose one with --scale" in capsys.readouterr().err
    assert main([*words, "--scale", "0.1"]) == 0
    printed = capsys.readouterr().out
    assert "mean flat (as dexgraspnet has it)" in printed and "meshes of unit size x 0.1" in printed
    labels = read_native(out)
    assert [label.object_id for label in labels] == ["my_box", "my_box"]
    np.testing.assert_allclose(labels[0].T_WH[:3, 3], [0.09, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(labels[0].hand_pose, np.zeros(45), atol=1e-12)
    assert main([*words, "--scale", "0.5"]) == 2
    assert "no grasp at the scale 0.5; it has 0.06, 0.1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"qpos": {"WRJTx": 0.1, "robot0:FFJ3": 0.2}}, "row 0: no grasp of MANO's hand (it has WRJTx, robot0:FFJ3)"),
        ({"qpos": {"trans": [0.0] * 2, "rot": [0.0] * 3, "thetas": [0.0] * 45}}, "trans has 2 numbers; expected 3"),
        ({"scale": float("nan")}, "no finite numbers"),
        ({"scale": None}, "no finite numbers"),
        ({"more": Path("x")}, "asks for 'pathlib"),
    ],
)
def test_other_npy_files(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    grasps = dexgraspnet([0.1])
    grasps[0] |= change
    np.save(tmp_path / "a.npy", grasps, allow_pickle=True)
    with pytest.raises(DataError) as caught:
        read_mano_table(tmp_path / "a.npy", "004", source=TABLE_SOURCES["dexgraspnet"])
    assert message in str(caught.value) and "a.npy" in str(caught.value)
    np.save(tmp_path / "b.npy", np.zeros((2, 3)))
    with pytest.raises(DataError, match="expected DexGraspNet's array of dictionaries"):
        read_mano_table(tmp_path / "b.npy", "004", source=TABLE_SOURCES["dexgraspnet"])
    with pytest.raises(DataError, match=r"b\.npy: a \.npy file.*--from dexgraspnet"):
        read_mano_table(tmp_path / "b.npy", "004")


def test_labels_of_an_added_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("dgrasp.objects.store.default_store", lambda: tmp_path / "store")
    J0 = wrist_joints(free_skin(), np.zeros((1, 1)))[0]
    np.savez(tmp_path / "a.npz", object=np.array(["my_box", "my_box"], dtype=object), betas=np.zeros((2, 6)),
             global_orient=np.zeros((2, 1, 3)), hand_pose=np.tile(np.eye(3), (2, 15, 1, 1)),
             transl=np.tile(np.array([0.09, 0.0, 0.0]) - J0, (2, 1)))  # fmt: skip
    words = ["labels", "import", "mano", str(tmp_path / "a.npz"), "--from", "hamer", *OPTIONS, "--out",
             str(tmp_path / "out.npz")]
    assert main(words) == 2
    assert "add its mesh with `dgrasp object add`" in capsys.readouterr().err
    trimesh.creation.box((0.05, 0.05, 0.05)).export(tmp_path / "my_box.obj")
    assert main(["object", "add", str(tmp_path / "my_box.obj"), "--units", "m", "--to", str(tmp_path / "store")]) == 0
    assert main(words) == 0
    labels = read_native(tmp_path / "out.npz")
    assert [(label.object_id, label.index) for label in labels] == [("my_box", 0), ("my_box", 1)]
    np.testing.assert_allclose(labels[1].T_WH[:3, 3], [0.09, 0.0, 0.0], atol=1e-12)
    # The check looks in the folder that it is told.
    check = ["labels", "check", str(tmp_path / "out.npz"), "--data", "free", "--store"]
    (tmp_path / "meshes").mkdir()
    assert main([*check, str(tmp_path / "store")]) == 0
    assert "2 labels of 1 objects" in capsys.readouterr().out
    assert main([*check, str(tmp_path / "meshes")]) == 2
    assert "unknown object 'my_box'" in (printed := capsys.readouterr().err) and "--store DIR" in printed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hand_pose": np.full((2, 45), 60.0)}, "row 0: hand_pose has an angle beyond 2 pi, as degrees would"),
        ({"global_orient": np.full((2, 3), 90.0)}, "row 0: global_orient has an angle beyond 2 pi, as degrees would"),
        ({"transl": np.array([[0.1, 0.0, 0.0], [90.0, 0.0, 0.0]])},
         "row 1: transl lies beyond 10 m, as millimetres would"),
    ],
)
def test_degrees_and_millimetres(
    tmp_path: Path, change: dict[str, Array], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arrays = {"betas": np.zeros((2, 6)), "global_orient": np.zeros((2, 3)), "hand_pose": np.zeros((2, 45)),
              "transl": np.zeros((2, 3)), "object": np.array(["061_foam_brick"] * 2)}
    np.savez(tmp_path / "a.npz", **(arrays | change))
    assert main(["labels", "import", "mano", str(tmp_path / "a.npz"), *OPTIONS, "--out", str(tmp_path / "o.npz"),
                 "--pose", "axis-angle", "--mean", "flat", "--fingers", "mano", "--transl", "mano",
                 "--object-at-origin"]) == 2
    assert message in (printed := capsys.readouterr().err) and "multiply by" in printed
