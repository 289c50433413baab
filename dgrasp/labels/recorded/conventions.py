"""The meaning of a table of MANO parameters where data sets differ: given, implied by the data, or found by key points.

Nothing is assumed. A question that neither the user nor the data answers is an error that names the option.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dgrasp.config.names import MANO_CONVENTIONS as CHOICES
from dgrasp.errors import DataError
from dgrasp.hand.mano.model import ManoModel
from dgrasp.hand.mano.params import ManoParams, hand_vertices, wrist_joints
from dgrasp.hand.mano.pose import from_pca
from dgrasp.hand.mano.skeleton import FINGERS, MANO_FINGERS
from dgrasp.labels.formats import checks
from dgrasp.labels.recorded.mano_table import ManoTable
from dgrasp.types import Array
from raisim_like.rotations import transform

FITS = 0.002
"""m. A reading of the table is confirmed if its key points lie this close to the given ones."""
COMPARED = 50
"""Largest number of rows whose key points are compared."""
SAME = 1e-6
"""m. Readings whose key points differ by less count as one."""
_FROM_PROJECT = [FINGERS.index(finger) for finger in MANO_FINGERS]
Answers = dict[str, str]


@dataclass(frozen=True, eq=False)
class TableGrasps:
    """Grasps of a table in its own frame A: T_AH (n, 4, 4), hand_pose (n, 45), T_AO (n, 4, 4), betas (n, S).

    answers: for each question, the answer and whether it was given, implied or found.
    """

    T_AH: Array
    hand_pose: Array
    T_AO: Array
    betas: Array
    answers: Answers


def read_grasps(table: ManoTable, model: ManoModel, given: Answers, mean_shape: bool, at_origin: bool) -> TableGrasps:
    """The table's grasps, by the answers `given` and those that the data implies or shows.

    mean_shape: the hands have MANO's mean shape and the table has no betas. at_origin: the objects are at the origin
    and the table has no poses for them. Raises `DataError` for anything missing or contradictory, or an open question.
    """
    n = len(table)
    if mean_shape == ("betas" in table.values):
        table.need("betas", "add them, or say --mean-shape")
        raise DataError(f"{table.path}: has betas; expected no --mean-shape then")
    betas = np.zeros((n, 1)) if mean_shape else table.values["betas"]
    try:
        betas = model.own_betas(betas)
        wrist_joints(model, betas)
    except DataError as error:
        raise DataError(f"{table.path}: {error}") from None
    _check_units(table, given)
    implied = _implied(table)
    for question, answer in implied.items():
        if given.get(question, answer) != answer:
            raise DataError(f"{table.path}: --{question} {given[question]} contradicts the data, which is {answer}")
    T_AO = _objects(table, at_origin, given)
    known = given | implied
    chosen, found = _choose(table, model, betas, list(_readings(known)))
    T_AH, hand_pose = _coordinates(table, model, betas, chosen, np.arange(n))
    notes = {key: f"{value} ({'given' if key in given else 'implied' if key in implied else found})"
             for key, value in chosen.items()}
    if "quaternion" in given and table.values.get("object_rotation", np.zeros((0, 3))).shape[1] == 4:
        notes["quaternion"] = f"{given['quaternion']} (given)"
    return TableGrasps(T_AH, hand_pose, T_AO, betas, notes)


def _check_units(table: ManoTable, given: Answers) -> None:
    """Radians and metres: a `DataError` names the first row in what looks like degrees or millimetres."""
    def where(row: int) -> str:
        return f"{table.path}: row {row}"

    pose = table.values.get("hand_pose", np.zeros((0, 0)))
    turns = {"global_orient": 3, "object_rotation": 3} | ({"hand_pose": 45} if given.get("pose") != "pca" else {})
    for name, width in turns.items():
        rows = table.values.get(name, pose[:, :0])
        if rows.shape[1] == width:
            checks.check_angles(rows, name, where)
    for name in ("transl", "object_translation", "joints"):
        if name in table.values:
            checks.check_positions(table.values[name], name, where)


def _implied(table: ManoTable) -> Answers:
    """The answers that follow from the shapes of the data."""
    pose = table.need("hand_pose", "give the finger pose")
    if pose.shape[1] < 45:
        return {"pose": "pca", "fingers": "mano"}
    # A matrix is the whole rotation of its joint: there is no mean to be added to.
    return {"pose": "axis-angle", "mean": "flat"} if table.matrices else {}


def _readings(known: Answers) -> Iterator[Answers]:
    """All answers to the questions about the hand that agree with what is known; PCA has MANO's order of fingers."""
    questions = ("pose", "mean", "fingers", "transl")
    for answers in itertools.product(*(CHOICES[q] if q not in known else (known[q],) for q in questions)):
        reading = dict(zip(questions, answers, strict=True))
        if reading["pose"] == "axis-angle" or reading["fingers"] == "mano":
            yield reading


def _coordinates(
    table: ManoTable, model: ManoModel, betas: Array, answers: Answers, rows: Array
) -> tuple[Array, Array]:
    """T_AH (r, 4, 4) and hand_pose (r, 45) of these rows (r,) in one reading."""
    orient = table.need("global_orient", "give the wrist's rotation vector")[rows]
    transl = table.need("transl", "give the translation")[rows]
    pose, betas = table.values["hand_pose"][rows], betas[rows]
    if answers["pose"] == "pca":
        vectors = from_pca(model, pose, flat_hand_mean=answers["mean"] == "flat")
    else:
        vectors = pose if answers["fingers"] == "mano" else pose.reshape(-1, 5, 9)[:, _FROM_PROJECT].reshape(-1, 45)
        vectors = vectors + (model.hands_mean if answers["mean"] == "mano" else 0.0)
    if answers["transl"] == "wrist":
        transl = transl - wrist_joints(model, betas)
    T_AH, hand_pose = ManoParams(orient, vectors, transl, betas).coordinates(model)
    if "hand_transform" in table.values:
        moves = table.values["hand_transform"][rows].reshape(-1, 4, 4)
        checks.check_transforms(moves, "hand_transform", lambda row: f"{table.path}: row {rows[row]}")
        T_AH = moves @ T_AH
    return T_AH, hand_pose


def _choose(table: ManoTable, model: ManoModel, betas: Array, options: list[Answers]) -> tuple[Answers, str]:
    """The one reading that is left, and how it was found."""
    if not options:
        raise DataError(f"{table.path}: --pose pca and --fingers project contradict each other: PCA has MANO's order")
    if len(options) == 1 and "joints" not in table.values:
        return options[0], "implied"
    unanswered = [q for q in ("pose", "mean", "fingers", "transl") if len({o[q] for o in options}) > 1]
    ask = ", ".join(f"--{q} {'|'.join(CHOICES[q])}" for q in unanswered)
    if "joints" not in table.values:
        raise DataError(f"{table.path}: the table does not say what its numbers mean; give {ask}; or add the key "
                        "points as `joints`, which show it")
    rows = np.linspace(0, len(table) - 1, min(len(table), COMPARED)).astype(int)
    given = table.values["joints"].reshape(len(table), -1, 3)[rows]
    errors, points = [], []
    for answers in options:
        points.append(hand_vertices(model, betas[rows], *_coordinates(table, model, betas, answers, rows))[1])
        # The file may have any order of key points. Tips are left out, because data sets define them differently.
        joints = points[-1][:, [k for k in range(21) if k % 4 or k == 0]]
        gaps = np.linalg.norm(joints[:, :, None] - given[:, None], axis=3).min(axis=2)
        errors.append(float(gaps.max()))
    best = int(np.argmin(errors))
    if errors[best] > FITS:
        asked = f"; the nearest reading is {options[best]}" if unanswered else ""
        raise DataError(f"{table.path}: the key points `joints` lie up to {1000 * errors[best]:.1f} mm from the hands "
                        f"that the parameters give{asked}; expected at most {1000 * FITS:g} mm; check the MANO file, "
                        "betas, units and what was given")
    rivals = [options[i] for i in range(len(options))
              if errors[i] <= FITS and float(np.abs(points[i] - points[best]).max()) > SAME]
    if rivals:
        raise DataError(f"{table.path}: its key points fit several readings ({options[best]} and {rivals[0]}); give "
                        f"{ask}")
    return options[best], "found by the key points"


def _objects(table: ManoTable, at_origin: bool, given: Answers) -> Array:
    """T_AO (n, 4, 4)."""
    from scipy.spatial.transform import Rotation

    there = [name for name in ("object_rotation", "object_translation") if name in table.values]
    if at_origin:
        if there:
            raise DataError(f"{table.path}: has {', '.join(there)}; expected no --object-at-origin then")
        return np.tile(np.eye(4), (len(table), 1, 1))
    remedy = "add it, or say --object-at-origin"
    rotation, place = (table.need(name, remedy) for name in ("object_rotation", "object_translation"))

    def where(row: int) -> str:
        return f"{table.path}: row {row}"

    if rotation.shape[1] == 3:
        R = Rotation.from_rotvec(rotation).as_matrix()
    elif rotation.shape[1] == 4:
        if "quaternion" not in given:
            raise DataError(f"{table.path}: object_rotation has four numbers, whose order the table does not say; give "
                            "--quaternion wxyz|xyzw")
        order = [0, 1, 2, 3] if given["quaternion"] == "wxyz" else [3, 0, 1, 2]
        rows = np.concatenate([np.zeros((len(table), 3)), rotation[:, order]], axis=1)
        R = checks.poses_from_quaternions(rows, "object_rotation", where)[:, :3, :3]
    else:
        R = rotation.reshape(-1, 3, 3)
    T_AO = transform(R, place)
    checks.check_transforms(T_AO, "the object's pose", where)
    return T_AO
