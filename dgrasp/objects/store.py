"""Objects that `dgrasp object add` wrote: one folder per object, found by name, and refused if changed later.

A folder holds `object.json` (what it was made of, mass, shapes, figures), `mesh.obj` (the repaired surface in O, m),
other files that the shapes need, and `picture.png`. O is the frame of the file that was added.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.paths import user_data_root
from dgrasp.objects.add.parts import convex_parts
from dgrasp.objects.model import ObjectModel
from dgrasp.objects.names import YCB_NAMES, nearest
from dgrasp.types import Array
from raisim_like.shapes import Kind, Shape

META_FILE, MESH_FILE, PICTURE_FILE = "object.json", "mesh.obj", "picture.png"
FORMAT, SCHEMA = "dgrasp-object", 1
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,99}")
"""Names that label files accept."""
_LEAST_RADIUS = 1e-5
"""m. Least radius of gyration. A wire of 0.1 mm has 0.025 mm."""
_SIZES = {"box": 3, "cylinder": 2, "capsule": 2, "sphere": 1, "hull": 0, "mesh": 0}


def default_store() -> Path:
    """The folder where objects are added and searched unless another one is named."""
    return user_data_root() / "objects"


def clean_name(text: str) -> str:
    """A text such as a file's name as the name of an object; what names cannot have becomes an underscore."""
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", text).lstrip("_.+-")


def check_name(name: str, file: Path) -> None:
    """Raise `DataError` if an object that is added from `file` cannot have this name."""
    if not NAME.fullmatch(name) or name in YCB_NAMES.values():
        why = "is one of the 20" if name in YCB_NAMES.values() else "expected letters, digits and _ . + -"
        raise DataError(f"{file}: the name {name[:100]!r} cannot be given to an object ({why}); choose another name "
                        "with --name")


@dataclass(frozen=True)
class StoredObject:
    """The folder of an added object, and its id, which ends in a hash of what the physics reads."""

    folder: Path
    id: str


def is_added(name: str, folders: Sequence[Path]) -> bool:
    """Whether one of the folders has an added object of that name."""
    return NAME.fullmatch(name) is not None and any(os.path.isfile(folder / name / META_FILE) for folder in folders)


def find_object(name: str, folders: Sequence[Path]) -> StoredObject:
    """An added object, from the first of `folders` that has it.

    Raises `DataError` if none has it, with the folders that were searched, and for a damaged object.
    """
    for folder in folders:
        if os.path.isfile(folder / name / META_FILE):
            return StoredObject(folder / name, read_meta(folder / name)["id"])
    found = [path for folder in folders if os.path.isdir(folder) for path in folder.glob(f"*/{META_FILE}")]
    there = sorted({path.parent.name for path in found})
    raise DataError(f"unknown object {name!r}: not one of the 20, and not in {' or '.join(map(str, folders))} (there: "
                    f"{', '.join(there[:20]) or 'nothing'}){nearest(name, [*there, *YCB_NAMES.values()])}; add its "
                    f"mesh with `dgrasp object add MESH --name {name}`, or name its folder with objects=DIR "
                    "(labels check, labels make, grasp: --store DIR)")


def load_object(folder: Path, official_compat: bool, parts: bool = False) -> ObjectModel:
    """The model of an added object.

    official_compat: 1 kg m^2 about every axis, as the authors simulate theirs; mass and centre of mass are its own.
    parts: cut a collision mesh into convex parts. Raises `DataError` if the folder is damaged or was changed.
    """
    meta = read_meta(folder)
    shapes = tuple(_shape(entry, folder) for entry in meta["shapes"])
    if parts and shapes[0].kind == "mesh" and shapes[0].file is not None:
        shapes = convex_parts(shapes[0].file)
    inertia = np.eye(3) if official_compat else np.array(meta["inertia"])
    return ObjectModel(meta["name"], shapes, meta["mass_kg"], np.array(meta["center_of_mass_O"]), inertia,
                       folder.absolute() / MESH_FILE)


def read_meta(folder: Path) -> dict[str, Any]:
    """The description of an added object. Raises `DataError` unless it is valid and the files are unchanged."""
    path = folder / META_FILE
    again = "add it again with `dgrasp object add`"
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path}: cannot be read ({str(error)[:200]}); {again}") from None
    if not isinstance(meta, dict) or meta.get("format") != FORMAT or meta.get("schema") != SCHEMA:
        raise DataError(f"{path}: not the description of an object (format {FORMAT!r}, schema {SCHEMA}); {again}")
    try:
        _check(meta, folder)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        why = f" ({error})" if isinstance(error, _NoBodyError) else ""
        raise DataError(f"{path}: the description is incomplete or has values out of range{why}; {again}") from None
    if meta["id"] != object_id(meta):
        raise DataError(f"{path}: was changed after the object was added (its id no longer matches mass, shapes and "
                        f"files); {again}")
    for name, digest in meta["files"].items():
        if not os.path.isfile(folder / name) or file_digest(folder / name) != digest:
            raise DataError(f"{folder}: {name} is missing or was changed after the object was added; {again}")
    return meta


def object_id(meta: dict[str, Any]) -> str:
    """The name, and a hash of everything that the physics reads from a description."""
    physics = {key: meta[key] for key in ("mass_kg", "center_of_mass_O", "inertia", "shapes")}
    physics["files"] = {file: digest for file, digest in meta["files"].items() if file != PICTURE_FILE}
    return f"{meta['name']}-{hashlib.sha256(json.dumps(physics, sort_keys=True).encode()).hexdigest()[:12]}"


def file_digest(path: Path) -> str:
    """SHA-256 of a file of an object, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _check(meta: dict[str, Any], folder: Path) -> None:
    """Raise one of the errors that `read_meta` catches unless an object can be built from the description."""
    files = meta["files"]
    _require(NAME.fullmatch(meta["name"]) and meta["name"] == folder.absolute().name and isinstance(meta["id"], str))
    _require(all(NAME.fullmatch(name) and isinstance(digest, str) for name, digest in files.items()))
    _require(MESH_FILE in files and meta["shapes"])
    mass, center, inertia = meta["mass_kg"], np.array(meta["center_of_mass_O"]), np.array(meta["inertia"])
    check_mass(mass, center.astype(float), inertia.astype(float))
    low, high = np.array(meta["figures"]["bounds_m"], dtype=float)
    if ((center < low - 1e-6) | (center > high + 1e-6)).any():
        raise _NoBodyError(f"the centre of mass {center.tolist()} lies outside the object")
    least, most = mass * _LEAST_RADIUS**2, mass * float(((high - low) ** 2).sum())
    for moment in np.linalg.eigvalsh(inertia):
        if not least <= moment <= most:
            raise _NoBodyError(f"a principal moment of {moment:.3g} kg m^2; expected {least:.3g} to {most:.3g} for "
                               f"{mass:g} kg of this size")
    for entry in meta["shapes"]:
        kind, size = entry["kind"], entry["size"]
        _require(len(size) == _SIZES[kind] and len(entry["position"]) == 3 and len(entry["quaternion"]) == 4)
        _require(all(math.isfinite(v) for v in [*size, *entry["position"], *entry["quaternion"]]))
        _require(all(v > 0 for v in size) and abs(np.linalg.norm(entry["quaternion"]) - 1.0) < 1e-6)
        _require(entry["file"] in files if kind in ("hull", "mesh") else "file" not in entry)


class _NoBodyError(ValueError):
    """Mass properties that no body has. The message is for users."""


def _require(ok: object) -> None:
    if not ok:
        raise ValueError("out of range")


def check_mass(mass: float, center: Array, inertia: Array) -> None:
    """Raise a `ValueError`, with the reason, unless a body of some size can have these properties.

    mass: kg. center: (3,) m. inertia: (3, 3) kg m^2 about the centre of mass.
    """
    if not (math.isfinite(mass) and 1e-4 <= mass <= 100.0):
        raise _NoBodyError(f"a mass of {mass:g} kg; expected 0.1 g to 100 kg")
    if center.shape != (3,) or not np.isfinite(center).all():
        raise _NoBodyError("the centre of mass is not three finite numbers")
    if inertia.shape != (3, 3) or not np.isfinite(inertia).all() or np.abs(inertia - inertia.T).max() > 1e-12:
        raise _NoBodyError("the inertia is not a symmetric matrix of finite numbers")
    low, middle, high = np.linalg.eigvalsh(inertia)
    if low <= 0.0 or high > (low + middle) * (1.0 + 1e-6):
        raise _NoBodyError(f"no body has the principal moments {low:.3g}, {middle:.3g}, {high:.3g} kg m^2: each is "
                           "positive and at most the sum of the others")


def plain_shape(shape: Shape) -> dict[str, Any]:
    """A shape as plain JSON values; its file is given by its name in the object's folder."""
    entry: dict[str, Any] = {"kind": shape.kind, "size": list(shape.size), "position": list(shape.position),
                             "quaternion": list(shape.quaternion)}
    return entry if shape.file is None else entry | {"file": shape.file.name}


def _shape(entry: dict[str, Any], folder: Path) -> Shape:
    x, y, z = entry["position"]
    a, b, c, d = entry["quaternion"]
    file = folder.absolute() / entry["file"] if "file" in entry else None
    return Shape(cast(Kind, entry["kind"]), tuple(entry["size"]), (x, y, z), (a, b, c, d), file)
