from __future__ import annotations

import collections
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.errors import DataError
from dgrasp.labels.formats.release import read_release
from tests.labels.files import dexycb_content, dump, static_content

BLEACH = "021_bleach_cleanser"


@pytest.mark.parametrize("aligned", [False, True], ids=["old joblib", "new joblib"])
def test_dexycb_layout(tmp_path: Path, aligned: bool) -> None:
    content = dexycb_content(objects=(12, 3), n=3)
    labels = read_release(dump(tmp_path / "a.pkl", content, aligned))
    # The file's order of objects, not that of their ids.
    assert [(label.object_id, label.index) for label in labels] == [
        (name, i) for name in (BLEACH, "004_sugar_box") for i in range(3)
    ]
    label, arrays = labels[4], content[3]
    np.testing.assert_array_equal(label.hand_pose, arrays["final_qpos"][1, 6:])
    np.testing.assert_array_equal(label.joints_W.ravel(), arrays["final_ee"][1])
    np.testing.assert_array_equal(label.goal_contacts, arrays["final_contacts"][1] == 1.0)
    assert label.goal_contacts.dtype == bool
    np.testing.assert_array_equal(label.T_WH[:3, 3], arrays["final_qpos"][1, :3])
    assert label.start is not None
    np.testing.assert_array_equal(label.start.hand_pose, arrays["qpos_reset"][1, 6:])
    np.testing.assert_array_equal(label.start.T_WO[:3, 3], arrays["obj_pose_reset"][1, :3])
    assert (label.hand, label.source, label.on_table) == ("mano_mean", "a.pkl", True)
    assert label.name == "a.pkl:004_sugar_box[1]"


@pytest.mark.parametrize("protocol", range(6))
def test_files_that_pickle_alone_wrote(tmp_path: Path, protocol: int) -> None:
    content = static_content(objects=(2,), n=2)
    expected = read_release(dump(tmp_path / "a.pkl", content))
    other = {key: np.asfortranarray(array.astype(">f8")) if isinstance(array, np.ndarray) else array
             for key, array in content[2].items()}
    forms: list[dict[Any, Any]] = [
        content, collections.OrderedDict({np.int64(2): other}),
        {2: {key.encode(): array for key, array in content[2].items()}},
    ]  # fmt: skip
    for form in forms:
        (tmp_path / "b.pkl").write_bytes(pickle.dumps(form, protocol))
        for found, one in zip(read_release(tmp_path / "b.pkl"), expected, strict=True):
            assert found.object_id == one.object_id
            np.testing.assert_array_equal(found.T_WH, one.T_WH)
            np.testing.assert_array_equal(found.joints_W, one.joints_W)


def test_rotations_by_hand(tmp_path: Path) -> None:
    content = dexycb_content(objects=(1,), n=1)
    arrays = content[1]
    arrays["qpos_reset"][0, 3:6] = [np.pi / 2, np.pi / 2, 0.0]
    arrays["obj_pose_reset"][0, 3:] = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    start = read_release(dump(tmp_path / "a.pkl", content))[0].start
    assert start is not None
    # Intrinsic XYZ: Rx(90) Ry(90). Columns: Rx Ry ex = Rx(-ez) = ey; Rx ey = ez; Rx Ry ez = Rx ex = ex.
    np.testing.assert_allclose(start.T_WH[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-15)
    # w, x, y, z = 90 degrees about z.
    np.testing.assert_allclose(start.T_WO[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    np.testing.assert_array_equal(start.T_WO[3], [0, 0, 0, 1])


def test_static_layout(tmp_path: Path) -> None:
    content = static_content(objects=(2,), n=2)
    labels = read_release(dump(tmp_path / "a.pkl", content))
    assert [label.start for label in labels] == [None, None]
    assert not any(label.on_table for label in labels)
    np.testing.assert_array_equal(labels[1].joints_W.ravel(), content[2]["final_wpos"][1])


def test_nearly_unit_quaternion_is_normalised(tmp_path: Path) -> None:
    content = static_content(objects=(2,), n=1)
    content[2]["final_obj"][0, 3:] *= 1.0009
    rotation = read_release(dump(tmp_path / "a.pkl", content))[0].T_WO[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


def test_float32_and_bool_arrays_are_taken(tmp_path: Path) -> None:
    content = static_content(objects=(2,), n=1)
    content[2]["final_qpos"] = content[2]["final_qpos"].astype(np.float32)
    content[2]["final_contacts"] = content[2]["final_contacts"].astype(bool)
    label = read_release(dump(tmp_path / "a.pkl", content))[0]
    assert label.hand_pose.dtype == np.float64


def _set(key: int, field: str, index: Any, value: float) -> Callable[[dict[int, Any]], None]:
    def change(content: dict[int, Any]) -> None:
        content[key][field][index] = value

    return change


def _replace(key: int, field: str, value: Any) -> Callable[[dict[int, Any]], None]:
    def change(content: dict[int, Any]) -> None:
        content[key][field] = value

    return change


def _drop(key: int, field: str) -> Callable[[dict[int, Any]], None]:
    return lambda content: content[key].pop(field)


@pytest.mark.parametrize(
    ("change", "where", "what"),
    [
        (_set(3, "final_qpos", (1, 7), np.nan), "004_sugar_box[1]", "final_qpos holds NaN"),
        (_set(3, "final_qpos", (1, 4), np.inf), "004_sugar_box[1]", "final_qpos holds NaN or infinity"),
        (_set(12, "final_ee", (0, 5), np.nan), f"{BLEACH}[0]", "final_ee holds NaN"),
        (_set(12, "final_obj_pos", (1, 0), np.nan), f"{BLEACH}[1]", "final_obj_pos holds NaN"),
        (_set(12, "qpos_reset", (1, 50), np.nan), f"{BLEACH}[1]", "qpos_reset holds NaN"),
        (_set(12, "final_pose", (1, 0), np.nan), f"{BLEACH}[1]", "final_pose holds NaN"),
        (_set(3, "obj_pose_reset", (0, slice(3, 7)), 0.0), "004_sugar_box[0]", "length 1"),
        (_set(3, "obj_pose_reset", (0, 3), 1e300), "004_sugar_box[0]", "length 1"),
        (_set(3, "final_obj_pos", (0, 2), 500.0), "004_sugar_box[0]", "expected metres"),
        (_set(3, "final_ee", (0, 62), -500.0), "004_sugar_box[0]", "expected metres"),
        (_set(3, "final_qpos", (0, 9), 90.0), "004_sugar_box[0]", "differs"),
        (_set(3, "qpos_reset", (0, 9), 90.0), "004_sugar_box[0]", "expected radians"),
        (_set(3, "final_contacts", (1, 15), 0.5), "004_sugar_box[1]", "expected 0 or 1"),
        (_set(3, "final_contacts", (1, 0), np.nan), "004_sugar_box[1]", "expected 0 or 1"),
        (_set(3, "final_qpos", (0, 0), 0.9), "004_sugar_box[0]", "wrist key point"),
        (_set(3, "final_pose", (1, 3), 6.0), "004_sugar_box[1]", "final_pose differs"),
        (_replace(3, "final_pose", np.zeros((3, 48))), "004_sugar_box", "final_pose has 3 rows and final_qpos 2"),
        (_replace(3, "final_pose", np.zeros((2, 3))), "004_sugar_box", "final_pose has shape (2, 3)"),
        (_replace(3, "obj_idx_stacked", np.array([2, 5], dtype=np.int32)), "004_sugar_box", "expected 2"),
        (_replace(3, "obj_idx_stacked", [2, 2]), "004_sugar_box", "does not name this object"),
        (_replace(3, "final_qpos", np.zeros((2, 48))), "004_sugar_box", "final_qpos has shape (2, 48)"),
        (_replace(3, "final_qpos", np.zeros(51)), "004_sugar_box", "final_qpos has shape (51,)"),
        (_replace(3, "final_ee", np.zeros((3, 63))), "004_sugar_box", "same number of labels"),
        (_replace(3, "final_ee", [1, 2]), "004_sugar_box", "final_ee is a list"),
        (_replace(3, "final_qpos", np.zeros((0, 51))), "004_sugar_box", "at least 1"),
        (_drop(3, "final_contacts"), "004_sugar_box", "lacks final_contacts"),
        (_drop(3, "final_ee"), "004_sugar_box", "lacks final_ee"),
    ],
)
def test_bad_labels_are_named(tmp_path: Path, change: Callable[[dict[int, Any]], Any], where: str, what: str) -> None:
    content = dexycb_content(objects=(12, 3))
    change(content)
    path = dump(tmp_path / "bad.pkl", content)
    with pytest.raises(DataError, match=re.escape(f"{path}: {where}: ") + ".*" + re.escape(what)):
        read_release(path)


def test_several_bad_labels_give_one_error_with_their_number(tmp_path: Path) -> None:
    content = dexycb_content(n=3)
    content[12]["final_ee"][:] = np.nan
    with pytest.raises(DataError, match=r"\[0\].*3 labels have this problem"):
        read_release(dump(tmp_path / "a.pkl", content))


@pytest.mark.parametrize("key", [19, 0, 22, -1, "004_sugar_box"])
def test_unknown_object_id(tmp_path: Path, key: int | str) -> None:
    content: dict[Any, Any] = dexycb_content(objects=(12,))
    content[key] = content.pop(12)
    with pytest.raises(DataError, match=f"unknown object id {key!r}"):
        read_release(dump(tmp_path / "a.pkl", content))


@pytest.mark.parametrize("content", [{}, [], [1, 2], "text", 5, {12: []}, {12: {}}, {"target_pos": np.zeros((3, 3))}])
def test_not_a_label_file(tmp_path: Path, content: Any) -> None:
    with pytest.raises(DataError, match="expected"):
        read_release(dump(tmp_path / "a.pkl", content))


@pytest.mark.parametrize("convention", ["xyz", "ZYX"])
def test_wrist_angles_of_another_convention_are_found(tmp_path: Path, convention: str) -> None:
    content = dexycb_content(n=5)
    qpos = content[3]["final_qpos"]
    qpos[:, 3:6] = Rotation.from_euler("XYZ", qpos[:, 3:6]).as_euler(convention)
    content[3]["final_pose"] = qpos[:, 3:].copy()
    with pytest.raises(DataError, match="knuckles"):
        read_release(dump(tmp_path / "a.pkl", content))


def test_missing_file_and_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "none.pkl", tmp_path):
        with pytest.raises(DataError, match="cannot be read"):
            read_release(path)
