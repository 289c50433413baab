"""Read HO3D's annotations: one pickle per frame, `<split>/<sequence>/meta/<frame>.pkl`, of a hand with a YCB object.

handPose (48,): rotation vectors of the wrist and the 15 finger joints from the flat hand, MANO's order. handTrans (3,):
MANO's translation. handBeta (10,). objRot (3,), objTrans (3,), objName. The frame is the camera's in OpenGL's
convention (y up, z backwards). Hand and object share it, so their relative pose does not depend on it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.arrays import plain_text
from dgrasp.files.joblib import PlainUnpickler
from dgrasp.files.pickles import read_pickle
from dgrasp.hand.mano.params import ManoParams
from dgrasp.labels.formats import checks
from dgrasp.labels.recorded.making import LabelMaker, numbered
from dgrasp.labels.recorded.skips import Skip
from dgrasp.objects.names import resolve_object
from dgrasp.types import Array, GraspLabel
from raisim_like.rotations import transform

MAX_FILE_BYTES = 4 * 2**20
"""Largest annotation that is read (they have some ten kilobytes)."""


@dataclass(frozen=True, eq=False)
class Annotation:
    """One frame, camera frame C: params (N = 1) of the hand, T_CO (4, 4), the object's name."""

    params: ManoParams
    T_CO: Array
    object: str


def find_frames(root: Path, every: int) -> list[Path]:
    """Each sequence's first annotation and every `every`-th after it, sorted; `root` is HO3D or a split of it."""
    root = Path(root)
    frames: dict[Path, list[Path]] = {}
    for pattern in ("*/meta/*.pkl", "*/*/meta/*.pkl"):
        for file in root.glob(pattern):
            frames.setdefault(file.parent, []).append(file)
    found = [file for folder in sorted(frames) for file in sorted(frames[folder])[::every]]
    if not found:
        raise DataError(f"{root}: no HO3D here; expected SPLIT/SEQUENCE/meta/FRAME.pkl, or one of its splits")
    return found


def read_annotation(path: Path) -> Annotation:
    """A frame's annotation. Raises `Skip` where hand or object is not annotated, `DataError` for a bad file."""
    from scipy.spatial.transform import Rotation

    content = read_pickle(path, PlainUnpickler, "HO3D annotation", MAX_FILE_BYTES)
    if not isinstance(content, dict):
        raise DataError(f"{path}: holds a {type(content).__name__}; expected a dictionary; get the file again")
    fields: dict[str, Array] = {}
    for what, widths in (("hand", {"handPose": 48, "handTrans": 3, "handBeta": 10}),
                         ("object", {"objRot": 3, "objTrans": 3})):
        if any(content.get(name) is None for name in widths):
            raise Skip(f"{what} not annotated")
        fields |= {name: _vector(content[name], name, width, path) for name, width in widths.items()}
    name = plain_text(content.get("objName"))
    if name is None:
        raise DataError(f"{path}: objName is no text; get the file again")
    try:
        known = resolve_object(name)
    except DataError as error:
        raise DataError(f"{path}: {str(error)[:300]}") from None

    def where(_: int) -> str:
        return str(path)

    pose = fields["handPose"]
    checks.check_angles(fields["objRot"][None], "objRot", where)
    checks.check_angles(pose[None], "handPose", where)
    for key in ("handTrans", "objTrans"):
        checks.check_positions(fields[key][None], key, where)
    params = ManoParams(pose[None, :3], pose[None, 3:], fields["handTrans"][None], fields["handBeta"][None])
    return Annotation(params, transform(Rotation.from_rotvec(fields["objRot"]).as_matrix(), fields["objTrans"]), known)


def _vector(value: Any, name: str, width: int, path: Path) -> Array:
    plain = isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.size == width
    if not plain or not np.isfinite(value).all():
        raise DataError(f"{path}: {name} is not {width} finite numbers; get the file again")
    return np.asarray(value, dtype=np.float64).reshape(width)


def import_ho3d(
    root: Path, maker: LabelMaker, every: int, progress: Callable[[list[Path]], Iterable[Path]] = iter
) -> tuple[list[GraspLabel], dict[str, tuple[str, str]]]:
    """Labels of every `every`-th frame in which the hand touches the object, and the skipped frames with reasons.

    The labels have no table and no approach. Their world is the object's frame, as for GraspTTA's and ContactOpt's.
    """
    labels, skipped = [], {}
    for path in progress(find_frames(root, every)):
        place = "/".join([*path.parts[-4:-2], path.stem])
        try:
            labels.append(_label(path, f"ho3d:{place}", maker))
        except Skip as skip:
            skipped[place] = (skip.reason, skip.detail)
        except DataError as error:
            skipped[place] = ("damaged or missing file", str(error))
    return numbered(labels), skipped


def _label(path: Path, source: str, maker: LabelMaker) -> GraspLabel:
    annotation = read_annotation(path)
    try:
        betas = maker.model.own_betas(annotation.params.betas)[0]
    except DataError as error:
        raise Skip("shape of another hand model", str(error)) from None
    T_CH, hand_pose = annotation.params.coordinates(maker.model)
    T_OH = np.linalg.inv(annotation.T_CO) @ T_CH[0]
    contacts = maker.contacts(maker.model, betas, T_OH, hand_pose[0], annotation.object)
    if not contacts.any():
        raise Skip("hand does not touch the object")
    return maker.label(annotation.object, T_OH, hand_pose[0], np.eye(4), contacts, None, source, on_table=False)
