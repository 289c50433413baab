"""The free hand's skinned model in MANO's layout, as it ships: data/free/hand/free_skin.npz.

`dgrasp.hand.free.make_skin` writes the file; it is read with the checks that a MANO file gets.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.npz import open_npz
from dgrasp.files.paths import data_root
from dgrasp.hand.free.anatomy import hand_parts
from dgrasp.hand.mano.file import model_of
from dgrasp.hand.mano.model import ManoModel
from dgrasp.hand.mano.pose import project_pose
from dgrasp.types import Array

HAND_NAME = "free"
"""The hand's id in labels (`GraspLabel.hand`)."""

SKIN_FILE = "free_skin.npz"
FORMAT, SCHEMA = "dgrasp-hand-model", 1
MAX_BYTES = 16 * 2**20

MEMBERS = ("v_template", "f", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "hands_mean",
           "hands_components")  # fmt: skip
"""The file's arrays, under MANO's names. The file also holds `meta`, a JSON text."""


def skin_path() -> Path:
    """The path of the file that ships."""
    return data_root() / "free" / "hand" / SKIN_FILE


@cache
def free_skin() -> ManoModel:
    """The model that ships: a right hand, its wrist at the origin."""
    return read_skin(skin_path())


def read_skin(path: Path) -> ManoModel:
    """Read the model of such a file. Raises `DataError` naming file and entry if it is missing, damaged, or no hand."""
    again = "write it anew with `python -m dgrasp.hand.free.make_skin`"
    with open_npz(path, "hand model", MAX_BYTES) as archive:
        lacking = [name for name in ("meta", *MEMBERS) if f"{name}.npy" not in archive.names]
        if lacking:
            raise DataError(f"{path}: lacks {', '.join(lacking)}; {again}")
        meta = json.loads(str(archive.read("meta", "U")))
        if not isinstance(meta, dict) or (meta.get("format"), meta.get("schema")) != (FORMAT, SCHEMA):
            raise DataError(f"{path}: not a hand model of format {FORMAT!r}, schema {SCHEMA}; {again}")
        content = {name: archive.read(name, "biuf") for name in MEMBERS}
    return model_of(content, path)


def free_limits() -> Array:
    """(45, 2) rad: the free hand's joint limits."""
    return np.concatenate([part.limits for part in hand_parts()[1:]])


@cache
def rest_pose() -> Array:
    """(45,) rad: the finger angles of a right hand at rest, which are the model's mean pose."""
    return project_pose(free_skin().hands_mean[None])[0]
