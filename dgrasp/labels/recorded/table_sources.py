"""The tables of data sets and estimators: their files, the names in them, and what their numbers mean.

Each convention was read in the source's own code (docs/labels.md names the files). `labels import mano
--from NAME` takes the answers from here; an option that is given as well goes before them.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.joblib import PlainUnpickler
from dgrasp.files.npz import open_npz
from dgrasp.files.pickles import load_pickle
from dgrasp.types import Array

Columns = dict[str, Any]
MAX_BYTES = 64 * 2**20
MAX_SEQUENCE_BYTES = 2**30
"""Of a sequence of GRAB when unpacked, of which only hand and object are read."""


@dataclass(frozen=True)
class TableSource:
    """One source. answers: to the questions of `conventions.CHOICES`.

    names: name in its files -> name of the quantity in `mano_table.WIDTHS`. inner: name of a dictionary of quantities
    in a .npz. read: reads the columns of a file of its
    own form; None for .npz and .csv alone. adapt: changes columns so that they mean what a table's do.
    """

    answers: Mapping[str, str]
    names: Mapping[str, str] = field(default_factory=dict)
    inner: str | None = None
    read: Callable[[Path], Columns | None] = lambda path: None
    adapt: Callable[[Columns], Columns] = lambda columns: columns


def _right_hands(columns: Columns) -> Columns:
    """The estimators flip the image of a left hand, so that its numbers are of its mirror image."""
    for name in ("right", "is_right"):
        left = np.flatnonzero(np.asarray(columns.pop(name, 1.0)).reshape(-1) == 0)
        if left.size:
            raise DataError(f"row {left[0]}: {name} is 0, a left hand, whose numbers are of its mirror image; keep the "
                            "rows of right hands")
    return columns


def _with_transform(columns: Columns) -> Columns:
    """ContactOpt's hand_pose is the wrist's turn and 15 coefficients; its transform moves the hand."""
    pose = np.asarray(columns.get("hand_pose", np.zeros((0, 0))))
    if pose.ndim == 2 and pose.shape[1] == 18 and "global_orient" not in columns:
        columns |= {"global_orient": pose[:, :3], "hand_pose": pose[:, 3:]}
    if pose.ndim == 2 and "transl" not in columns:
        columns["transl"] = np.zeros((len(pose), 3))
    return columns


def _turned_objects(columns: Columns) -> Columns:
    """GRAB multiplies row vectors by the object's matrix: its rotation is the inverse."""
    turn = columns.get("object_rotation")
    if isinstance(turn, np.ndarray) and turn.ndim == 2 and turn.shape[1] == 3:
        columns["object_rotation"] = -turn
    return columns


def _grab_sequence(path: Path) -> Columns | None:
    """A sequence's right hand and object, frame by frame; None for a table."""
    if path.suffix != ".npz":
        return None
    with open_npz(path, "sequence of GRAB", MAX_SEQUENCE_BYTES) as archive:
        if "rhand.npy" not in archive.names and "lhand.npy" in archive.names:
            raise DataError(f"{path}: no rhand; expected a sequence of GRAB with its right hand")
        if not {"rhand.npy", "object.npy"} <= set(archive.names):
            return None
        entries = {name: archive.read(name, "OU").item() for name in ("rhand", "object", "obj_name")
                   if f"{name}.npy" in archive.names}
        hand, thing = (entries[name].get("params") for name in ("rhand", "object"))
    if not isinstance(hand, dict) or not isinstance(thing, dict):
        raise DataError(f"{path}: no params of rhand and object; expected a sequence of GRAB")
    columns = {name: hand.get(name) for name in ("global_orient", "hand_pose", "transl")}
    columns |= {"object_rotation": thing.get("global_orient"), "object_translation": thing.get("transl")}
    if isinstance(entries.get("obj_name"), str) and isinstance(columns["transl"], np.ndarray):
        columns["object"] = [entries["obj_name"]] * len(columns["transl"])
    return columns


def _grasptta_json(path: Path) -> Columns | None:
    """The 61 numbers and the object's pose [R | t] of each grasp; the file is named after the object's number."""
    if path.suffix != ".json":
        return None
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f"{path}: over {MAX_BYTES >> 20} MiB; split it")
        content = json.loads(path.read_text(encoding="utf-8"))
        params = np.array(content["recon_params"], dtype=float).reshape(-1, 61)
        poses = np.array(content["R_list"], dtype=float).reshape(len(params), 3, 4)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise DataError(f"{path}: not GraspTTA's JSON ({str(error)[:100]}); expected recon_params (n, 1, 61) and "
                        "R_list (n, 3, 4)") from None
    columns: Columns = {"params": params, "object_rotation": poses[:, :, :3], "object_translation": poses[:, :, 3]}
    number = re.fullmatch(r"obj_id_(\d{1,3})", path.stem)
    return columns | ({"object": [f"{int(number[1]):03d}"] * len(params)} if number else {})


def _dexgraspnet_npy(path: Path) -> Columns | None:
    """A list of grasps, each a dictionary with `scale` and `qpos`: trans, rot, thetas."""
    if path.suffix != ".npy":
        return None
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f"{path}: over {MAX_BYTES >> 20} MiB; split it")
        stream = io.BytesIO(path.read_bytes())
        np.lib.format.read_magic(stream)
        _, _, dtype = np.lib.format.read_array_header_1_0(stream)
        if dtype.kind != "O":
            raise DataError(f"{path}: an array of {dtype}; expected DexGraspNet's array of dictionaries")
        grasps = load_pickle(stream.read(), PlainUnpickler, "DexGraspNet file")
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (ValueError, SyntaxError, EOFError) as error:
        raise DataError(f"{path}: not a .npy file ({str(error)[:100]})") from None
    except DataError as error:
        raise DataError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    rows = [_grasp(path, row, grasp) for row, grasp in enumerate(np.ravel(grasps).tolist())]
    table = np.array(rows).reshape(len(rows), 52)
    return {"scale": table[:, 0], "transl": table[:, 1:4], "global_orient": table[:, 4:7], "hand_pose": table[:, 7:]}


def _grasp(path: Path, row: int, grasp: Any) -> list[float]:
    """Scale, trans, rot and thetas of one grasp."""
    qpos = grasp.get("qpos") if isinstance(grasp, dict) else None
    if not isinstance(qpos, dict) or "thetas" not in qpos:
        keys = ", ".join(map(str, qpos))[:200] if isinstance(qpos, dict) else type(grasp).__name__
        raise DataError(f"{path}: row {row}: no grasp of MANO's hand (it has {keys or 'nothing'}); expected scale and "
                        "qpos with trans, rot and thetas, as the MANO branch of DexGraspNet writes them")
    numbers = [grasp.get("scale")]
    for name, width in (("trans", 3), ("rot", 3), ("thetas", 45)):
        values = np.ravel(np.asarray(qpos.get(name), dtype=object)).tolist()
        if len(values) != width:
            raise DataError(f"{path}: row {row}: {name} has {len(values)} numbers; expected {width}")
        numbers += values
    if not all(isinstance(number, (int, float)) and abs(number) < 1e4 for number in numbers):
        raise DataError(f"{path}: row {row}: scale, trans, rot or thetas holds no finite numbers; remove the row")
    return [float(number) for number in numbers]


_ESTIMATOR = TableSource(
    {"pose": "axis-angle", "mean": "flat", "fingers": "mano", "transl": "mano"},
    {"pred_cam_t_full": "transl", "pred_cam_t": "transl", "cam_t_full": "transl", "cam_t": "transl",
     "pred_betas": "betas"},
    inner="pred_mano_params", adapt=_right_hands,
)  # fmt: skip
TABLE_SOURCES: dict[str, TableSource] = {
    "hamer": _ESTIMATOR,
    "wilor": _ESTIMATOR,
    "grasptta": TableSource({"pose": "axis-angle", "mean": "flat", "fingers": "mano", "transl": "mano"},
                          {"recon_params": "params"}, read=_grasptta_json),
    "contactopt": TableSource({"pose": "pca", "mean": "mano", "fingers": "mano", "transl": "mano"},
                            {"hand_beta": "betas", "hand_mTc": "hand_transform"}, adapt=_with_transform),
    "dexgraspnet": TableSource({"pose": "axis-angle", "mean": "flat", "fingers": "mano", "transl": "mano"},
                             {"thetas": "hand_pose", "rot": "global_orient", "trans": "transl"},
                             read=_dexgraspnet_npy),
    "grab": TableSource({"mean": "flat", "fingers": "mano", "transl": "mano"}, read=_grab_sequence,
                      adapt=_turned_objects),
}  # fmt: skip
"""By the name that `--from` takes."""


def rotation_vectors(array: Array, rows_of_6d: bool) -> Array:
    """(n, J * 3) rotation vectors of J = 1 or 15 rotations per row: matrices (n, J * 9) or 6D (n, J * 6).

    6D numbers are a matrix's first two columns, or its first two rows where `rows_of_6d`. Raises ValueError where a
    matrix is none of a rotation.
    """
    from scipy.spatial.transform import Rotation

    n, width = array.shape
    if width in (9, 135):
        R: Array = array.reshape(-1, 3, 3)
        off = np.abs(np.einsum("nij,nkj->nik", R, R) - np.eye(3)).max(axis=(1, 2), initial=0.0)
        bad = np.flatnonzero((off > 1e-3) | (np.linalg.det(R) < 0.0))
    else:
        a, b = array.reshape(-1, 2, 3).swapaxes(0, 1)
        size = np.linalg.norm(a, axis=1)
        first = a / np.maximum(size, 1e-9)[:, None]
        second = b - (first * b).sum(axis=1)[:, None] * first
        length = np.linalg.norm(second, axis=1)
        bad = np.flatnonzero((size < 1e-6) | (length < 1e-6))
        second /= np.maximum(length, 1e-9)[:, None]
        R = np.stack([first, second, np.cross(first, second)], axis=1 if rows_of_6d else 2)
    if bad.size:
        raise ValueError(f"row {bad[0] // (len(R) // n)}")
    return np.asarray(Rotation.from_matrix(R).as_rotvec().reshape(n, -1))
