"""The project's own label file: one compressed .npz of plain arrays and a JSON text, without pickles.

Members (n labels of a hand with J finger joints, P parts and K key points; m, rad, world frame with z up; rotations as
matrices):
`meta` the JSON text, which names joints, parts and key points in the order of the arrays; `object`, `source` (n,)
indices into the tables of names in it; `index` (n,); `hand_pose` (n, J); `T_WH`, `T_WO` (n, 4, 4); `joints_W`
(n, K, 3); `goal_contacts` (n, P); `has_start`, `on_table` (n,); `start_T_WH`, `start_T_WO` (n, 4, 4) and
`start_hand_pose` (n, J), which are identity and zero where there is no start. Floats are float64, so that reading gives
back what was written.

Files of schema 1 have no names. Their hands have MANO's joints.
"""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.atomic import write_atomic
from dgrasp.files.npz import open_npz
from dgrasp.hand.layout import HandNames
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels.formats import checks
from dgrasp.types import Array, GraspLabel, StartPose

FORMAT = "dgrasp-labels"
SCHEMA = 2
MAX_BYTES = 64 * 2**20
"""Largest size of all members together, unpacked; 376 labels have 0.9 MB."""

_UNITS = {"length": "m", "angle": "rad", "frame": "world, z up", "euler": "intrinsic XYZ"}
_KINDS: dict[str, type] = {
    "object": np.int32, "source": np.int32, "index": np.int32, "hand_pose": np.float64, "T_WH": np.float64,
    "T_WO": np.float64, "joints_W": np.float64, "goal_contacts": np.bool_, "has_start": np.bool_,
    "on_table": np.bool_, "start_T_WH": np.float64, "start_T_WO": np.float64, "start_hand_pose": np.float64,
}  # fmt: skip
_NAMED = ("joints", "parts", "keypoints")
_MOST_NAMES = 1000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,99}")
Arrays = dict[str, Array]


def _shapes(names: HandNames) -> dict[str, tuple[int, ...]]:
    """The shape of each member except `meta`, for one label."""
    pose = (len(names.joints),)
    shaped = {"hand_pose": pose, "start_hand_pose": pose, "joints_W": (len(names.keypoints), 3),
              "goal_contacts": (len(names.parts),)}  # fmt: skip
    return {name: shaped.get(name, (4, 4) if "T_W" in name else ()) for name in _KINDS}


def write_native(
    path: Path, labels: list[GraspLabel], provenance: str | dict[str, Any], licence: str, names: HandNames
) -> None:
    """Write `labels`, all of one hand, with their provenance and their licence.

    names: the hand's joints, parts and key points (`HandLayout.names`).

    The file is replaced in one step, and its bytes depend on the content alone. Raises `DataError` for no labels,
    labels of several hands, and everything that `read_native` would refuse.
    """
    path = Path(path)
    hands = sorted({label.hand for label in labels})
    if len(hands) != 1:
        raise DataError(f"{path}: labels of {len(hands)} hands ({', '.join(hands) or 'none'}); expected labels of one "
                        "hand; write one file for each")
    objects = list(dict.fromkeys(label.object_id for label in labels))
    sources = list(dict.fromkeys(label.source for label in labels))
    meta = {"format": FORMAT, "schema": SCHEMA, "units": _UNITS, "hand": hands[0], "licence": licence,
            "provenance": provenance, "objects": objects, "sources": sources,
            **{name: list(getattr(names, name)) for name in _NAMED}}
    neutral = StartPose(np.eye(4), np.eye(4), np.zeros(len(names.joints)))
    starts = [label.start or neutral for label in labels]
    values: dict[str, list[Any]] = {
        "object": [objects.index(label.object_id) for label in labels],
        "source": [sources.index(label.source) for label in labels],
        "has_start": [label.start is not None for label in labels],
        "start_T_WH": [start.T_WH for start in starts],
        "start_T_WO": [start.T_WO for start in starts],
        "start_hand_pose": [start.hand_pose for start in starts],
    }
    arrays: Arrays = {}
    for name, shape in _shapes(names).items():
        dtype = _KINDS[name]
        rows = values.get(name) or [getattr(label, name) for label in labels]
        wrong = next((i for i, row in enumerate(rows) if np.shape(row) != shape), None)
        if wrong is not None:
            raise DataError(f"{path}: {labels[wrong].name}: {name} has shape {np.shape(rows[wrong])}; expected {shape}")
        arrays[name] = np.asarray(rows).astype(dtype)
        if dtype is not np.float64:
            lossless = (arrays[name] == np.asarray(rows)).reshape(len(rows), -1).all(axis=1)
            checks.require(lossless, lambda i: f"{path}: {labels[i].name}",
                           f"{name} does not fit {np.dtype(dtype)}", "give whole numbers, and contacts of 0 or 1")
    try:
        text = json.dumps(meta, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise DataError(f"{path}: provenance cannot be written as JSON ({error}); give texts, numbers, lists") from None
    _check(path, _meta(path, np.array(text)), arrays)
    stream = io.BytesIO()
    packed: dict[str, Any] = {"meta": np.array(text), **arrays}
    np.savez_compressed(stream, **packed)
    write_atomic(path, stream.getvalue())


def read_native(path: Path) -> list[GraspLabel]:
    """Read the labels of a file of this format. Raises `DataError` naming the file, and the label if one is bad."""
    return read_native_with_meta(path)[0]


def read_native_with_meta(path: Path) -> tuple[list[GraspLabel], dict[str, Any]]:
    """Read the labels and the file's description: hand, licence, provenance, units, tables of names (`names_of`)."""
    path = Path(path)
    members = _unpack(path)
    meta = _meta(path, members.pop("meta"))
    _check(path, meta, members)
    a = members
    labels = [
        GraspLabel(
            meta["objects"][a["object"][i]], a["hand_pose"][i], a["T_WH"][i], a["T_WO"][i], a["joints_W"][i],
            a["goal_contacts"][i],
            StartPose(a["start_T_WH"][i], a["start_T_WO"][i], a["start_hand_pose"][i]) if a["has_start"][i] else None,
            meta["hand"], meta["sources"][a["source"][i]], int(a["index"][i]), bool(a["on_table"][i]),
        )
        for i in range(len(a["object"]))
    ]
    return labels, meta


def _unpack(path: Path) -> Arrays:
    """All members as arrays. Before anything is unpacked, sizes are checked to be small and as stated."""
    expected = {f"{name}.npy" for name in ("meta", *_KINDS)}
    with open_npz(path, "label file", MAX_BYTES) as archive:
        names = archive.names
        # The schema is read first, because a newer file may have other members.
        if names.count("meta.npy") == 1:
            _meta(path, archive.read("meta", "U"))
        if set(names) != expected or len(names) != len(expected):
            lacking, extra = sorted(expected - set(names)), sorted(set(names) - expected)
            raise DataError(f"{path}: lacks {', '.join(lacking) or 'nothing'}, also has "
                            f"{', '.join(extra)[:200] or 'nothing'}; expected the members of a label file of "
                            f"schema {SCHEMA}; write it anew with `dgrasp labels`")
        kinds = {"meta": "U", **{name: np.dtype(dtype).kind for name, dtype in _KINDS.items()}}
        return {name: archive.read(name, kind) for name, kind in kinds.items()}


def _meta(path: Path, text: Array) -> dict[str, Any]:
    """Parse and check the description."""
    try:
        meta = json.loads(str(text[()])) if text.shape == () else None
    except (ValueError, RecursionError):
        meta = None
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise DataError(f"{path}: its description is not that of a label file; expected a JSON text with format "
                        f"{FORMAT!r}; give a file written by `dgrasp labels`")
    schema = meta.get("schema")
    if isinstance(schema, bool) or not isinstance(schema, int):
        raise DataError(f"{path}: no schema number; expected schema {SCHEMA}; write the file anew")
    if schema > SCHEMA:
        raise DataError(f"{path}: schema {schema} is newer than this program, which reads {SCHEMA}; update the program")
    if schema < 1:
        raise DataError(f"{path}: schema {schema}; expected 1 to {SCHEMA}; write the file anew")
    if schema == 1:
        meta |= {name: list(getattr(MANO_NAMES, name)) for name in _NAMED}
    if meta.get("units") != _UNITS:
        raise DataError(f"{path}: units other than {_UNITS}; convert the file")
    for key in ("hand", "licence"):
        if not _is_line(meta.get(key)):
            raise DataError(f"{path}: no {key} in its description; expected one line of text; write the file anew")
    if not isinstance(meta.get("provenance"), (str, dict)):
        raise DataError(f"{path}: no provenance in its description; expected a text or a dictionary")
    for key in ("objects", "sources", *_NAMED):
        table = meta.get(key)
        if not isinstance(table, list) or not all(_is_line(name) for name in table):
            raise DataError(f"{path}: no table of {key} in its description; expected a list of names")
    for key in _NAMED:
        if not 1 <= len(meta[key]) <= _MOST_NAMES or len(set(meta[key])) < len(meta[key]):
            raise DataError(f"{path}: {len(meta[key])} names of {key}, or one of them twice; expected each once, and 1 "
                            f"to {_MOST_NAMES} of them")
    return meta


def names_of(meta: dict[str, Any]) -> HandNames:
    """The names of joints, parts and key points in a file's description."""
    return HandNames(*(tuple(meta[key]) for key in _NAMED))


def _is_line(value: Any) -> bool:
    """Whether `value` is one printable line of text: no control characters, not too long."""
    return isinstance(value, str) and 0 < len(value) <= 500 and value.isprintable()


def _check(path: Path, meta: dict[str, Any], arrays: Arrays) -> None:
    """Check shapes and values of all arrays, for reading and writing alike."""
    strange = [name for name in meta["objects"] if not _NAME.fullmatch(name)]
    if strange:
        raise DataError(f"{path}: object name {strange[0][:60]!r}; expected letters, digits and _ . + -")
    n = len(arrays["object"]) if arrays["object"].ndim else 0
    if n == 0:
        raise DataError(f"{path}: no labels; expected at least one")
    for name, shape in _shapes(names_of(meta)).items():
        dtype = _KINDS[name]
        if arrays[name].dtype != np.dtype(dtype) or arrays[name].shape != (n, *shape):
            raise DataError(f"{path}: {name} is {arrays[name].dtype} of shape {arrays[name].shape}; expected "
                            f"{np.dtype(dtype)} of shape {(n, *shape)}; write the file anew")
    for name, table in (("object", meta["objects"]), ("source", meta["sources"])):
        checks.require((arrays[name] >= 0) & (arrays[name] < len(table)), lambda i: f"{path}: label {i}",
                       f"its {name} is not in the table of {len(table)} names", "write the file anew")
    checks.require(arrays["index"] >= 0, lambda i: f"{path}: label {i}", "negative index", "write the file anew")

    def where(i: int) -> str:
        return f"{path}: {meta['objects'][arrays['object'][i]]}[{arrays['index'][i]}]"

    for name in ("T_WH", "T_WO", "start_T_WH", "start_T_WO"):
        checks.check_transforms(arrays[name], name, where)
    for name in ("hand_pose", "start_hand_pose"):
        checks.check_finite(arrays[name], name, where)
        checks.check_angles(arrays[name], name, where)
    checks.check_finite(arrays["joints_W"], "joints_W", where)
    checks.check_positions(arrays["joints_W"], "joints_W", where)
    checks.check_wrist_keypoint(arrays["T_WH"][:, :3, 3], arrays["joints_W"], where)
