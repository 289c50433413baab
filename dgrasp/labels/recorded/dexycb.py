"""Read DexYCB's files: sequences of a hand that takes one of the objects from a table.

`<subject>/<sequence>/meta.yml` and `pose.npz`, `calibration/extrinsics_<id>/extrinsics.yml`,
`calibration/mano_<id>/mano.yml`. Poses are in the frame of the master camera, in metres. A tag lies on the table.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.npz import open_npz
from dgrasp.files.yaml import numbers, read_yaml
from dgrasp.hand.mano.model import ManoModel
from dgrasp.hand.mano.params import ManoParams
from dgrasp.hand.mano.pose import from_pca
from dgrasp.labels.formats import checks
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.types import Array
from raisim_like.rotations import transform

MAX_POSE_BYTES = 16 * 2**20
"""Largest pose.npz (72 frames have some tens of kilobytes)."""
MAX_FRAMES, MAX_OBJECTS = 10_000, 21
LEAST_HEIGHT = 0.1
"""m. The cameras' median distance from the table's plane must be at least this."""
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,99}")
_FLIP = np.diag([1.0, -1.0, -1.0])
_T = TypeVar("_T")


@dataclass(frozen=True)
class Sequence:
    """One recording: its name "subject/sequence", folder, the grasped object's DexYCB id and place in `pose_y`.

    side: "right" or "left". frames, objects: how many there are. extrinsics, mano: ids of the calibrations.
    """

    name: str
    folder: Path
    grasped: int
    place: int
    side: str
    frames: int
    objects: int
    extrinsics: str
    mano: str


@dataclass(frozen=True, eq=False)
class Track:
    """The poses of a sequence, camera frame C.

    hand (F, 51): rotation vector, 45 PCA coefficients, translation. hand_seen, object_seen (F,) bool: whether they are
    annotated. T_CO (F, 4, 4): the grasped object; the identity where it is not annotated.
    """

    hand: Array
    hand_seen: Array
    T_CO: Array
    object_seen: Array

    def wrists(self, model: ManoModel, betas: Array) -> tuple[Array, Array]:
        """Wrists T_CH (F, 4, 4) and finger angles (F, 45) for the shape betas (S,)."""
        pose = from_pca(model, self.hand[:, 3:48], flat_hand_mean=False)
        params = ManoParams(self.hand[:, :3], pose, self.hand[:, 48:], np.tile(betas, (len(self.hand), 1)))
        return params.coordinates(model)


def find_sequences(root: Path) -> list[Path]:
    """The folders of all sequences, sorted. Raises `DataError` if `root` holds none."""
    root = Path(root)
    found = sorted(path.parent for path in root.glob("*/*/meta.yml")) if root.is_dir() else []
    if not found:
        raise DataError(f"{root}: no DexYCB here; expected SUBJECT/SEQUENCE/meta.yml and calibration/, as in the "
                        "folder that DEX_YCB_DIR names")
    return found


def read_sequence(folder: Path) -> Sequence:
    """Read a sequence's `meta.yml`. Raises `DataError` naming the file for anything that does not fit."""
    path = folder / "meta.yml"
    meta = read_yaml(path)
    fields: list[Any] = [meta.get(key) for key in ("ycb_ids", "ycb_grasp_ind", "num_frames")]
    objects, place, frames = fields
    if not isinstance(objects, list) or not 1 <= len(objects) <= MAX_OBJECTS or not all(map(_is_count, objects)):
        raise DataError(f"{path}: ycb_ids is no list of DexYCB ids; get the file again")
    if not _is_count(place) or place >= len(objects):
        raise DataError(f"{path}: ycb_grasp_ind names none of the {len(objects)} objects; get the file again")
    if not _is_count(frames) or not 1 <= frames <= MAX_FRAMES:
        raise DataError(f"{path}: num_frames is not a number from 1 to {MAX_FRAMES}; get the file again")
    sides, calibrations = meta.get("mano_sides"), meta.get("mano_calib")
    if not isinstance(sides, list) or len(sides) != 1 or sides[0] not in ("right", "left"):
        raise DataError(f"{path}: mano_sides is not one of [right] and [left]; get the file again")
    mano = calibrations[0] if isinstance(calibrations, list) and len(calibrations) == 1 else None
    ids = {"mano_calib": mano, "extrinsics": meta.get("extrinsics")}
    for key, value in ids.items():
        if not isinstance(value, str) or not _ID.fullmatch(value):
            raise DataError(f"{path}: {key} names no calibration; expected letters, digits, _ and -")
    name = f"{folder.parent.name}/{folder.name}"
    return Sequence(name, folder, objects[place], place, sides[0], frames, len(objects), str(ids["extrinsics"]),
                    str(mano))


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**31


def read_track(sequence: Sequence) -> Track:
    """Read the poses of a sequence. Raises `DataError` for shapes, values or units that do not fit."""
    path = sequence.folder / "pose.npz"
    with open_npz(path, "pose file", MAX_POSE_BYTES) as archive:
        hand, objects = (archive.read(name, "f").astype(np.float64) for name in ("pose_m", "pose_y"))
    shapes = {"pose_m": (hand, (sequence.frames, 1, 51)), "pose_y": (objects, (sequence.frames, sequence.objects, 7))}
    for name, (array, shape) in shapes.items():
        if array.shape != shape:
            raise DataError(f"{path}: {name} has shape {array.shape}; expected {shape}, as meta.yml says")
        if not np.isfinite(array).all():
            raise DataError(f"{path}: {name} holds NaN or infinity; get the file again")
    hand, pose = hand[:, 0], objects[:, sequence.place]
    hand_seen = (hand != 0.0).any(axis=1)
    # An object that is not annotated has the identity: no turn, no shift.
    object_seen = (pose[:, [0, 1, 2, 4, 5, 6]] != 0.0).any(axis=1)
    rows = np.where(object_seen[:, None], pose, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])

    def where(frame: int) -> str:
        return f"{path}: frame {frame}"

    T_CO = checks.poses_from_quaternions(rows[:, [4, 5, 6, 3, 0, 1, 2]], "pose_y", where)
    checks.check_positions(hand[:, 48:], "pose_m's translation", where)
    checks.check_angles(np.linalg.norm(hand[:, :3], axis=1), "pose_m's rotation", where)
    coefficients = np.asarray((np.abs(hand[:, 3:48]) <= 20.0).all(axis=1))
    checks.require(coefficients, where, "pose_m has a PCA coefficient beyond 20; expected a few units",
                   "get the file again")
    return Track(hand, hand_seen, T_CO, object_seen)


@dataclass
class Calibration:
    """The calibrations below `root`, each read once. flipped: ids of extrinsics whose tag's z points into the table."""

    root: Path
    flipped: set[str] = field(default_factory=set)
    _known: dict[str, Any] = field(default_factory=dict)

    def betas(self, mano: str) -> Array:
        """(10,) the shape of a subject's hand."""
        path = self.root / "calibration" / f"mano_{mano}" / "mano.yml"
        return self._once(path, lambda: numbers(read_yaml(path).get("betas"), range(1, 11), f"{path}: betas"))

    def world(self, extrinsics: str) -> Array:
        """T_WC (4, 4): the camera frame in a world whose z is up and whose table top is at z = 0.5 m.

        x and y are the tag's. A tag faces down if the cameras are on its side of negative z; it is then turned about x.
        """
        path = self.root / "calibration" / f"extrinsics_{extrinsics}" / "extrinsics.yml"
        return self._once(path, lambda: self._read_world(path, extrinsics))

    def _read_world(self, path: Path, extrinsics: str) -> Array:
        poses = read_yaml(path).get("extrinsics")
        if not isinstance(poses, dict) or "apriltag" not in poses or not 2 <= len(poses) <= 100:
            raise DataError(f"{path}: no extrinsics of cameras and apriltag; get the file again")
        T = {str(key): _rigid(value, f"{path}: {str(key)[:50]}") for key, value in poses.items()}
        T_CT = T.pop("apriltag")
        heights = [float(T_CT[:3, 2] @ (T_CS[:3, 3] - T_CT[:3, 3])) for T_CS in T.values()]
        side = float(np.median(heights))
        if abs(side) < LEAST_HEIGHT:
            raise DataError(f"{path}: cameras on both sides of the tag's plane, or in it; expected most of them more "
                            f"than {LEAST_HEIGHT:g} m above the table; get the file again")
        R = T_CT[:3, :3].T
        if side < 0.0:
            self.flipped.add(extrinsics)
            R = _FLIP @ R
        return transform(R, np.array([0.0, 0.0, TABLE_TOP]) - R @ T_CT[:3, 3])

    def _once(self, path: Path, read: Callable[[], _T]) -> _T:
        """The cached result or error of `read`: hundreds of sequences share a calibration."""
        key = str(path)
        if key not in self._known:
            try:
                self._known[key] = read()
            except DataError as error:
                self._known[key] = error
        value = self._known[key]
        if isinstance(value, DataError):
            raise value
        return value


def _rigid(value: Any, where: str) -> Array:
    """(4, 4) from 12 numbers, 3 x 4 row by row. The rotation, written with few digits, is made exact."""
    from scipy.spatial.transform import Rotation

    rows = numbers(value, range(12, 13), where).reshape(3, 4)
    R = rows[:, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
        raise DataError(f"{where}: not a rotation and a translation, 3 x 4 row by row; get the file again")
    checks.check_positions(rows[None, :, 3], "the translation", lambda _: where)
    return transform(Rotation.from_matrix(R).as_matrix(), rows[:, 3])
