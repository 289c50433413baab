"""A cache of labels, keyed by everything that they depend on."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.atomic import write_atomic
from dgrasp.labels.recorded.skips import Skip
from dgrasp.types import GraspLabel, StartPose

MAX_BYTES = 200_000


class LabelCache:
    """A folder of one small JSON file per label, or per reason why there is none. Its files may be deleted."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)

    def _path(self, key: dict[str, Any]) -> Path:
        return self.folder / f"{hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()}.json"

    def get(self, key: dict[str, Any]) -> GraspLabel | Skip | None:
        """The label or reason stored under this key; None if there is none or the file is damaged."""
        try:
            path = self._path(key)
            if path.stat().st_size > MAX_BYTES:
                return None
            content = json.loads(path.read_text(encoding="utf-8"))
            if "skip" in content:
                return Skip(str(content["skip"]), str(content["detail"]))
            return _label(content)
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None

    def put(self, key: dict[str, Any], value: GraspLabel | Skip) -> None:
        """Store a label or a reason. A folder that cannot be written is ignored."""
        if isinstance(value, Skip):
            content: dict[str, Any] = {"skip": value.reason, "detail": value.detail}
        else:
            content = dataclasses.asdict(value)
        with contextlib.suppress(DataError):
            write_atomic(self._path(key), json.dumps(content, default=lambda array: array.tolist()))


_SHAPES = {"hand_pose": (45,), "T_WH": (4, 4), "T_WO": (4, 4), "joints_W": (21, 3)}


def _label(content: dict[str, Any]) -> GraspLabel:
    """The label in a file's content. Raises for anything that is not a label."""
    start = content["start"]
    contacts = np.array(content["goal_contacts"])
    if contacts.shape != (16,) or contacts.dtype != bool:
        raise ValueError("contacts")
    return GraspLabel(
        **{name: _array(content, name) for name in _SHAPES},
        object_id=str(content["object_id"]), goal_contacts=contacts,
        start=None if start is None else StartPose(*(_array(start, n) for n in ("T_WH", "T_WO", "hand_pose"))),
        hand=str(content["hand"]), source=str(content["source"]), index=0, on_table=bool(content["on_table"]),
    )


def _array(content: dict[str, Any], name: str) -> Any:
    array = np.array(content[name], dtype=np.float64)
    if array.shape != _SHAPES[name] or not np.isfinite(array).all():
        raise ValueError(name)
    return array
