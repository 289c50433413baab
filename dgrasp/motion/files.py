"""Read targets from a user's file: a list of poses, or a trajectory of poses over time (docs/motion.md)."""

from __future__ import annotations

import csv
import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files import csv_text
from dgrasp.files.pickles import HEADS
from dgrasp.motion.paths import sample
from dgrasp.motion.targets import TargetSet, easy_targets
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion, transform

FRAMES = ("world", "label")
MAX_BYTES = 2**26
MAX_SECONDS = 300.0
MAX_POSITION = 10.0
"""m. A position beyond it is taken to be in another unit."""
QUATERNION_TOLERANCE = 1e-2
_WORLD = ("x", "y", "z", "qw", "qx", "qy", "qz")
_LABEL = ("dx", "dy", "dz", *_WORLD[3:])
_EXPECTED = (
    "expected position (n, 3) m, quaternion (n, 4) w x y z, optionally time (n,) s, and frame \"world\" or \"label\"; "
    f"in CSV the columns {', '.join(_WORLD)} (or {', '.join(_LABEL[:3])} for the frame of the label), optionally t"
)

_ONE_EXPECTED = (
    "expected \"dx dy dz\" or \"dx dy dz qw qx qy qz\", a displacement in m and a rotation from where the object lies, "
    "or a file of such a pose or trajectory"
)


def read_targets(path: Path, period: float) -> TargetSet:
    """Read the targets of a JSON, CSV or npz file, or of the authors' pickle. period: s per control step.

    Without times, each pose is a target of its own. With times, the poses are one trajectory. Raises `DataError` naming
    file and row.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f"{path}: over {MAX_BYTES >> 20} MiB; {_EXPECTED}")
        raw = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    if raw.startswith(HEADS):
        return easy_targets(path)
    columns = _npz(path, raw) if raw.startswith(b"PK") else _text(path, raw)
    T, time = _poses(path, columns), _time(path, columns)
    relative = _frame(path, columns) == "label"
    if time is None:
        return TargetSet(path.name, T[:, None], relative)
    return TargetSet(path.name, sample(time, T, period)[None], relative)


def read_target(text: str, period: float) -> TargetSet:
    """One target or one trajectory: the text "dx dy dz [qw qx qy qz]", or a file as `read_targets` takes it.

    The text is a displacement (m) and a rotation from the label's pose, along the world's axes. Raises `DataError`,
    naming the option --to, for anything else, and for a file of several targets.
    """
    words = text.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if not numbers:
        path = Path(os.path.expanduser(text))
        if not os.path.isfile(path):
            raise DataError(f"--to {text!r:.100}: neither numbers nor a file; {_ONE_EXPECTED}")
        found = read_targets(path, period)
        if len(found.T) != 1:
            raise DataError(f"--to {path}: {len(found.T)} targets; expected one pose, or one trajectory with times t "
                            "(`dgrasp test --motion FILE` goes to each pose of a file)")
        return found
    if len(numbers) not in (3, 7):
        raise DataError(f"--to {text!r:.100}: {len(numbers)} numbers; {_ONE_EXPECTED}")
    columns = {"position": [numbers[:3]], "quaternion": [numbers[3:] or [1.0, 0.0, 0.0, 0.0]]}
    return TargetSet(" ".join(words), _poses(Path(f"--to {text!r}"), columns)[:, None], relative=True)


def _npz(path: Path, raw: bytes) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as entries:
            if sum(entry.file_size for entry in entries.infolist()) > MAX_BYTES:
                raise ValueError(f"over {MAX_BYTES >> 20} MiB")
        with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
            columns = {name: archive[name] for name in ("position", "quaternion", "time", "frame") if name in archive}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(f"{path}: damaged, or not an .npz of plain arrays ({error}); {_EXPECTED}") from None
    if "frame" in columns:
        columns["frame"] = str(columns["frame"])
    return columns


def _text(path: Path, raw: bytes) -> dict[str, Any]:
    try:
        text = csv_text.decoded(raw)
    except UnicodeDecodeError:
        raise DataError(f"{path}: neither text nor .npz; {_EXPECTED}") from None
    if not text.lstrip().startswith("{"):
        return _csv(path, text)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: not valid JSON ({error}); {_EXPECTED}") from None
    return dict(content)


def _csv(path: Path, text: str) -> dict[str, Any]:
    try:
        header, lines = csv_text.cells(text)
        rows = [row for _, row in lines]
    except csv.Error as error:
        raise DataError(f"{path}: not CSV ({error}); {_EXPECTED}") from None
    names = next((names for names in (_WORLD, _LABEL) if set(names) <= set(header)), None)
    if names is None:
        raise DataError(f"{path}: the first line has the columns {', '.join(header)[:200] or 'nothing'}; {_EXPECTED}")
    values = []
    for number, row in enumerate(rows):
        try:
            values.append([float(row[header.index(name)]) for name in (*names, *(["t"] if "t" in header else []))])
        except (ValueError, IndexError):
            raise DataError(f"{path}: row {number}: not every column holds a number; {_EXPECTED}") from None
    if not values:
        raise DataError(f"{path}: no rows after the first line; {_EXPECTED}")
    table = np.array(values)
    columns = {"position": table[:, :3], "quaternion": table[:, 3:7], "frame": "world" if names is _WORLD else "label"}
    return columns | ({"time": table[:, 7]} if "t" in header else {})


def _array(path: Path, columns: dict[str, Any], name: str, width: int | None) -> Array:
    if name not in columns:
        raise DataError(f"{path}: no {name}; {_EXPECTED}")
    try:
        array = np.asarray(columns[name])
        shape = array.shape if width is None else array.shape[:-1]
        if array.dtype.kind not in "iuf" or len(shape) != 1 or (width is not None and array.shape[-1] != width):
            raise ValueError
    except ValueError:
        raise DataError(f"{path}: {name} is not a plain array of this shape; {_EXPECTED}") from None
    array = array.astype(float)
    _require(path, np.isfinite(array.reshape(len(array), -1)).all(axis=1), f"{name} is not finite")
    return array


def _poses(path: Path, columns: dict[str, Any]) -> Array:
    """(n, 4, 4), n > 0."""
    position, quaternion = _array(path, columns, "position", 3), _array(path, columns, "quaternion", 4)
    if len(position) != len(quaternion) or len(position) == 0:
        raise DataError(f"{path}: {len(position)} positions and {len(quaternion)} quaternions; expected equal numbers, "
                        "at least one of each")
    near = np.abs(position).max(axis=1) <= MAX_POSITION
    _require(path, near, f"the position is beyond {MAX_POSITION:g} m; expected metres")
    off = np.abs(np.linalg.norm(quaternion, axis=1) - 1.0)
    _require(path, off <= QUATERNION_TOLERANCE, "the quaternion is not of length 1; expected w, x, y, z")
    return transform(matrix_from_quaternion(quaternion), position)


def _time(path: Path, columns: dict[str, Any]) -> Array | None:
    if "time" not in columns:
        return None
    time = _array(path, columns, "time", None)
    if len(time) != len(columns["position"]) or len(time) < 2:
        raise DataError(f"{path}: {len(time)} times for {len(columns['position'])} poses; expected one each, 2 or more")
    later = np.diff(time, prepend=-np.inf) > 0.0
    _require(path, later, "the time is not later than in the row before; expected increasing seconds")
    if time[0] < 0.0 or time[-1] > MAX_SECONDS:
        raise DataError(f"{path}: times from {time[0]:g} to {time[-1]:g} s; expected 0 to {MAX_SECONDS:g} s")
    return time


def _frame(path: Path, columns: dict[str, Any]) -> str:
    frame = columns.get("frame")
    if frame not in FRAMES:
        raise DataError(f"{path}: frame is {frame!r:.60}; expected \"world\" (poses in the world, the table's top at "
                        "z = 0.5 m) or \"label\" (displacements from the object's pose in the label)")
    return str(frame)


def _require(path: Path, ok: Array, problem: str) -> None:
    bad = np.flatnonzero(~ok)
    if bad.size:
        raise DataError(f"{path}: row {bad[0]}: {problem}" + (f" ({bad.size} rows have this problem)" * (bad.size > 1)))
