"""The grasp labels of the authors' release, as `GraspLabel`s.

A file is a joblib pickle: a dictionary from DexYCB object id to arrays with one row per grasp. Two layouts:

- DexYCB: `final_qpos` (n, 51) wrist position, wrist Euler angles (intrinsic XYZ), 45 finger angles, in a
  world whose table top is z = 0.5 m; `final_ee` (n, 63) key points; `final_obj_pos` (n, 7) position and
  quaternion w, x, y, z; `final_contacts` (n, 16); `qpos_reset`, `obj_pose_reset`: the start of the approach.
- GraspTTA and ContactOpt: one static grasp of an object at the origin, `final_qpos`, `final_wpos` (n, 63),
  `final_obj` (n, 7), `final_contacts`; neither a start nor a table.

The order of the objects in the file is kept, because results are reported in it.
"""

from __future__ import annotations

import reprlib
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.joblib import read_joblib_arrays
from dgrasp.hand.store import AUTHORS_HAND
from dgrasp.labels.formats import checks
from dgrasp.objects.names import YCB_NAMES
from dgrasp.types import Array, GraspLabel, StartPose

_DEXYCB = {
    "final_qpos": 51, "final_ee": 63, "final_obj_pos": 7, "final_contacts": 16, "qpos_reset": 51, "obj_pose_reset": 7,
}
_STATIC = {"final_qpos": 51, "final_wpos": 63, "final_obj": 7, "final_contacts": 16}
_KNUCKLES = [1, 5, 9, 13, 17]
_PALM_TOLERANCE = 0.005


def read_release(path: Path) -> list[GraspLabel]:
    """Read the labels of one file of the release, in the file's order; `index` counts within the object.

    Raises `DataError` naming file, object and index for a damaged file or a label that cannot be used:
    missing keys, wrong shapes, NaN, quaternions off unit length by more than 1e-3, wrong units, contacts
    other than 0 and 1, unknown object ids, key points that do not fit the pose.
    """
    path = Path(path)
    content = read_joblib_arrays(path)
    if not isinstance(content, dict) or not content:
        raise DataError(f"{path}: holds a {type(content).__name__}; expected a dictionary from DexYCB object id to "
                        "arrays; give a label file of the authors' release")
    labels: list[GraspLabel] = []
    for key, arrays in content.items():
        labels += _object_labels(path, _object_name(path, key), key, arrays)
    _check_palm(path, labels)
    return labels


def _object_name(path: Path, key: Any) -> str:
    if isinstance(key, bool) or not isinstance(key, int) or key not in YCB_NAMES:
        raise DataError(f"{path}: unknown object id {_shown(key)}; expected DexYCB ids "
                        f"({', '.join(str(k) for k in YCB_NAMES)}); give a label file of the authors' release")
    return YCB_NAMES[key]


def _shown(key: Any) -> str:
    """A dictionary key as a short text for a message, whatever the file holds."""
    return "a huge number" if isinstance(key, int) and abs(key) > 10**9 else reprlib.repr(key)


def _object_labels(path: Path, name: str, key: int, arrays: Any) -> list[GraspLabel]:
    place = f"{path}: {name}"

    def where(row: int) -> str:
        return f"{place}[{row}]"

    fields = _fields(place, arrays)
    rows = {field: checks.as_rows(arrays[field], field, (width,), place) for field, width in fields.items()}
    counts = {field: len(array) for field, array in rows.items()}
    n = counts["final_qpos"]
    if n == 0 or len(set(counts.values())) > 1:
        raise DataError(f"{place}: rows per array {counts}; expected the same number of labels in each, at least 1; "
                        "get the file again")
    _check_redundant(arrays, key, rows["final_qpos"], place, where)

    with_start = fields is _DEXYCB
    keypoints, object_pose = ("final_ee", "final_obj_pos") if with_start else ("final_wpos", "final_obj")
    T_WH, fingers = _hand(rows["final_qpos"], "final_qpos", where)
    T_WO = checks.poses_from_quaternions(rows[object_pose], object_pose, where)
    checks.check_finite(rows[keypoints], keypoints, where)
    checks.check_positions(rows[keypoints], keypoints, where)
    joints = rows[keypoints].reshape(n, 21, 3)
    checks.check_wrist_keypoint(T_WH[:, :3, 3], joints, where)
    contacts = checks.check_contacts(rows["final_contacts"], "final_contacts", where)
    starts: list[StartPose | None] = [None] * n
    if with_start:
        start_T_WH, start_fingers = _hand(rows["qpos_reset"], "qpos_reset", where)
        start_T_WO = checks.poses_from_quaternions(rows["obj_pose_reset"], "obj_pose_reset", where)
        starts = [StartPose(start_T_WH[i], start_T_WO[i], start_fingers[i]) for i in range(n)]
    return [
        GraspLabel(
            object_id=name, hand_pose=fingers[i], T_WH=T_WH[i], T_WO=T_WO[i], joints_W=joints[i],
            goal_contacts=contacts[i], start=starts[i], hand=AUTHORS_HAND, source=path.name, index=i,
            on_table=with_start,
        )
        for i in range(n)
    ]


def _fields(place: str, arrays: Any) -> dict[str, int]:
    """The fields and widths of the layout that `arrays` follows."""
    if not isinstance(arrays, dict):
        raise DataError(f"{place}: holds a {type(arrays).__name__}; expected a dictionary of arrays; "
                        "get the file again")
    fields = _STATIC if "final_wpos" in arrays and "final_ee" not in arrays else _DEXYCB
    missing = [field for field in fields if field not in arrays]
    if missing:
        there = ", ".join(_shown(key) for key in list(arrays)[:20]) or "nothing"
        raise DataError(f"{place}: lacks {', '.join(missing)}; it has {there}; expected {', '.join(fields)}; "
                        "give a label file of the authors' release")
    return fields


def _hand(rows: Array, name: str, where: checks.Where) -> tuple[Array, Array]:
    """Wrist transforms (n, 4, 4) and finger angles (n, 45) of generalised coordinates (n, 51)."""
    pose = checks.poses_from_euler(rows[:, :6], name, where)
    checks.check_finite(rows[:, 6:], name, where)
    checks.check_angles(rows[:, 6:], name, where)
    return pose, rows[:, 6:].copy()


def _check_redundant(arrays: dict[str, Any], key: int, qpos: Array, place: str, where: checks.Where) -> None:
    """Check that values which the files hold twice agree: the pose, and the object's index (its id minus 1)."""
    if "final_pose" in arrays:
        pose = checks.as_rows(arrays["final_pose"], "final_pose", (48,), place)
        if len(pose) != len(qpos):
            raise DataError(f"{place}: final_pose has {len(pose)} rows and final_qpos {len(qpos)}; get the file again")
        checks.check_finite(pose, "final_pose", where)
        with np.errstate(invalid="ignore"):
            agree = (np.abs(pose - qpos[:, 3:]) <= 1e-3).all(axis=1)
        # A NaN in final_qpos is reported as such by a later check.
        agree |= ~np.isfinite(qpos).all(axis=1)
        checks.require(agree, where, "final_pose differs from the angles of final_qpos; expected the same pose",
                       "get the file again")
    for field in ("obj_idx_stacked", "obj_idx"):
        if field in arrays:
            index = arrays[field]
            if not isinstance(index, np.ndarray) or index.shape != (len(qpos),) or (index != key - 1).any():
                raise DataError(f"{place}: {field} does not name this object; expected {key - 1} (its id minus 1) in "
                                f"all {len(qpos)} rows; get the file again")


def _check_palm(path: Path, labels: list[GraspLabel]) -> None:
    """Check that the knuckles lie at the same place in every wrist frame, because one hand made all labels.

    This finds a wrist rotation in another convention, or key points in another frame or order.
    """
    if len(labels) < 3:
        return
    T_WH = np.stack([label.T_WH for label in labels])
    knuckles = np.stack([label.joints_W[_KNUCKLES] for label in labels])
    local = np.einsum("nji,nkj->nki", T_WH[:, :3, :3], knuckles - T_WH[:, None, :3, 3])
    off = np.linalg.norm(local - np.median(local, axis=0), axis=2).max(axis=1)
    checks.require(off <= _PALM_TOLERANCE, lambda i: f"{path}: {labels[i].object_id}[{labels[i].index}]",
                   "the knuckles do not lie where the wrist's rotation puts them in the other labels; expected "
                   "intrinsic XYZ Euler angles and key points in the order wrist, index, middle, ring, little, thumb",
                   "check the convention of the angles")
