"""A built hand's folder, and any hand by name: what `hand=` and `dgrasp hand report` take.

A folder holds `hand.urdf`, its meshes, and `hand.json`, which says what it was made of. The hand's id ends in a hash
of what the physics reads, so labels made for one hand never pass for those of another.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dgrasp.errors import DataError
from dgrasp.files.paths import data_root
from dgrasp.hand.free.skin import HAND_NAME as FREE_HAND
from dgrasp.hand.mano.skeleton import PARTS
from dgrasp.hand.model import HandModel, load_hand
from raisim_like.errors import UrdfError
from raisim_like.urdf import read_urdf

URDF_FILE, META_FILE = "hand.urdf", "hand.json"
FORMAT, SCHEMA = "dgrasp-hand", 1
_AUTHORS_HANDS = ("mano_mean", "mano_mean_meshcoll", "mano_mean_nocoll")


@dataclass(frozen=True)
class NamedHand:
    """A hand and what is known of how it was made: hand.json of a built one, else empty."""

    model: HandModel
    meta: dict[str, Any]


def is_built_hand(folder: Path) -> bool:
    """Whether the folder was written by `dgrasp hand build`."""
    return os.path.isfile(folder / META_FILE) and os.path.isfile(folder / URDF_FILE)


def content_hash(urdf: Path) -> str:
    """SHA-256 of a URDF and of the meshes that it collides with, by their names; hexadecimal."""
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

    Raises `DataError` where the folder is no such hand, or was changed after it was built.
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
                        "changed after it was built, and labels made for it may no longer fit; build it again")
    return folder / URDF_FILE, found, meta


def _is_figures(row: Any) -> bool:
    """Whether a part's entry holds the figures that the report shows."""
    return isinstance(row, dict) and all(isinstance(row.get(key), float) for key in ("overlap", "mesh_volume_cm3"))


def find_hand(name: str) -> tuple[Path, str] | None:
    """URDF and id of a hand by folder or URDF file; None where there is neither.

    A URDF's id is its file's name without the suffix; the variants of the authors' hand are all "mano_mean".
    """
    path = Path(os.path.expanduser(name))
    if os.path.isdir(path) and is_built_hand(path):
        return built_hand(path)[:2]
    if not os.path.isfile(path):
        return None
    if path.name == URDF_FILE and is_built_hand(path.parent):
        return built_hand(path.parent)[:2]
    if path.stem == "free_hand":
        return path, FREE_HAND
    return path, _AUTHORS_HANDS[0] if path.stem in _AUTHORS_HANDS else path.stem


def open_hand(name: str) -> NamedHand:
    """A hand by name: "free", a built hand's folder, or a URDF file. A `DataError` says what else was given."""
    if name == FREE_HAND and not os.path.exists(name):
        return NamedHand(load_hand(data_root() / "free" / "hand" / "free_hand.urdf", FREE_HAND), {})
    found = find_hand(name)
    if found is None:
        raise DataError(f"{name}: no hand; expected \"free\", a folder written by `dgrasp hand build`, or a URDF file")
    urdf, identity = found
    meta = built_hand(urdf.parent)[2] if is_built_hand(urdf.parent) and urdf.name == URDF_FILE else {}
    return NamedHand(load_hand(urdf, identity), meta)
