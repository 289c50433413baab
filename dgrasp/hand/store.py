"""Read a built hand's folder, and find any hand by name, as `hand=` and `dgrasp hand report` take it.

A folder holds `hand.urdf`, its meshes, and `hand.json`, which says what the hand was made from. The hand's id ends in a
hash of what the physics reads, so labels made for one hand are never taken for those of another.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dgrasp.errors import DataError
from dgrasp.files.paths import data_root
from dgrasp.hand.free.skin import HAND_NAME as FREE_HAND
from dgrasp.hand.layout import Side
from dgrasp.hand.load import load_hand
from dgrasp.hand.mano.skeleton import PARTS
from dgrasp.hand.model import HandModel
from raisim_like.errors import UrdfError
from raisim_like.urdf import read_urdf

URDF_FILE, META_FILE = "hand.urdf", "hand.json"
FORMAT, SCHEMA = "dgrasp-hand", 1
FREE_URDF = Path("free_hand.urdf")
AUTHORS_HAND = "mano_mean"
_AUTHORS_HANDS = (AUTHORS_HAND, "mano_mean_meshcoll", "mano_mean_nocoll")


@dataclass(frozen=True)
class HandSource:
    """Where a hand comes from, and what its URDF does not say.

    side, weight_carried, mano: as `load.load_hand` takes them. meta: hand.json of a built hand, else empty.
    """

    urdf: Path
    id: str
    side: Side | None = "right"
    weight_carried: bool = True
    mano: bool = False
    meta: dict[str, Any] = field(default_factory=dict)

    def load(self) -> HandModel:
        """Load the hand. Raises `DataError` that says what is wrong with its URDF."""
        return load_hand(self.urdf, self.id, self.side, self.weight_carried, self.mano)


@dataclass(frozen=True)
class NamedHand:
    """A hand and how it was made. meta: hand.json of a built hand, else empty."""

    model: HandModel
    meta: dict[str, Any]


def is_built_hand(folder: Path) -> bool:
    """Whether the folder was written by `dgrasp hand build`."""
    return os.path.isfile(folder / META_FILE) and os.path.isfile(folder / URDF_FILE)


def content_hash(urdf: Path) -> str:
    """SHA-256 of a URDF and of its collision meshes with their names, in hexadecimal."""
    try:
        shapes = [shape for link in read_urdf(urdf).links for shape in link.shapes]
    except UrdfError as error:
        raise DataError(str(error)) from None
    digest = hashlib.sha256(urdf.read_bytes())
    for file in sorted({shape.file for shape in shapes if shape.file is not None}):
        digest.update(f"\n{file.name}\n".encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def hand_id(name: str, urdf: Path) -> str:
    """The id of a built hand: its name and the first digits of its hash."""
    return f"{name}-{content_hash(urdf)[:12]}"


def built_hand(folder: Path) -> tuple[Path, str, dict[str, Any]]:
    """URDF, id and description of a built hand's folder.

    Raises `DataError` if the folder holds no built hand, or was changed after the hand was built.
    """
    path = folder / META_FILE
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path}: cannot be read ({str(error)[:200]}); build the hand again") from None
    if not isinstance(meta, dict) or meta.get("format") != FORMAT or meta.get("schema") != SCHEMA:
        raise DataError(f"{path}: not the description of a built hand (format {FORMAT!r}, schema {SCHEMA}); "
                        "build it again with `dgrasp hand build`")
    texts = [meta.get(key) for key in ("name", "id", "side", "model_file", "limits", "licence")]
    parts = meta.get("parts")
    whole = isinstance(parts, dict) and all(_is_figures(parts.get(part)) for part in PARTS)
    if not whole or not all(isinstance(text, str) and 0 < len(text) < 300 and text.isprintable() for text in texts):
        raise DataError(f"{path}: the description is incomplete; build the hand again with `dgrasp hand build`")
    found = hand_id(meta["name"], folder / URDF_FILE)
    if found != meta["id"]:
        raise DataError(f"{folder}: the files give the hand {found!r}, but {META_FILE} says {meta['id']!r}; they were "
                        "changed after the build, and labels made for the hand may no longer fit; build it again")
    return folder / URDF_FILE, found, meta


def _is_figures(row: Any) -> bool:
    """Whether a part's entry holds the figures that the report shows."""
    return isinstance(row, dict) and all(isinstance(row.get(key), float) for key in ("overlap", "mesh_volume_cm3"))


def find_hand(name: str) -> HandSource | None:
    """Find a hand by its folder or URDF file; None if there is neither.

    A URDF's id is its file's name without the suffix. All variants of the authors' hand have the id "mano_mean".
    """
    path = Path(os.path.expanduser(name))
    if os.path.isdir(path) and is_built_hand(path):
        return _built_source(path)
    if not os.path.isfile(path):
        return None
    if path.name == URDF_FILE and is_built_hand(path.parent):
        return _built_source(path.parent)
    if path.stem == FREE_URDF.stem:
        return free_source(path)
    return authors_source(path) if path.stem in _AUTHORS_HANDS else HandSource(path, path.stem)


def free_source(urdf: Path) -> HandSource:
    """The free hand, from its URDF."""
    return HandSource(urdf, FREE_HAND, mano=True)


def authors_source(urdf: Path) -> HandSource:
    """The hand of the authors' release. Its palm has its mass on the first slider, so it needs no arm."""
    return HandSource(urdf, AUTHORS_HAND, weight_carried=False, mano=True)


def _built_source(folder: Path) -> HandSource:
    urdf, identity, meta = built_hand(folder)
    return HandSource(urdf, identity, meta["side"], mano=True, meta=meta)


def open_hand(name: str) -> NamedHand:
    """Open a hand by name: "free", a built hand's folder, or a URDF file. Raises `DataError` for any other name."""
    if name == FREE_HAND and not os.path.exists(name):
        source: HandSource | None = free_source(data_root() / "free" / "hand" / FREE_URDF)
    else:
        source = find_hand(name)
    if source is None:
        raise DataError(f"{name}: no hand; expected \"free\", a folder written by `dgrasp hand build`, or a URDF file")
    return NamedHand(source.load(), source.meta)
