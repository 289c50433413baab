"""Read a user's mesh file (OBJ, STL, PLY or GLB) within limits, and give its triangles in metres.

The readers are this project's own: trimesh's misread decimal commas, tabs and negative indices, and leave out what they
do not know without a message.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.obj_file import read_obj
from dgrasp.objects.add.glb_file import read_glb
from dgrasp.objects.add.ply_file import read_ply
from dgrasp.objects.add.stl_file import read_stl
from dgrasp.types import Array

FORMATS = ("obj", "stl", "ply", "glb")
MAX_BYTES = 512 * 2**20
MAX_FACES = 5_000_000
KEPT_FACES = 500_000
"""A mesh of more is decimated to this number."""
SMALLEST, LARGEST = 0.005, 1.0
"""m. Limits of an object's longest side."""
USUAL = (0.01, 0.5)
"""m. Usual range of the longest side of an object that a hand grasps, from which units are guessed."""
_NORMALISED = (0.999, 2.001)
"""Longest sides, in the file's numbers, of meshes that were normalised to a cube or a ball and have no unit."""

Units = Literal["auto", "m", "cm", "mm"]
SCALES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_ANNOUNCED = 20 * MAX_FACES
"""Most rows that a file's header may announce in all; for more, nothing is allocated."""


@dataclass(frozen=True, eq=False)
class MeshFile:
    """The triangles of a file, unchanged.

    vertices (V, 3), in the file's units; faces (F, 3). sha256: of the file's bytes, hexadecimal. notes: what was done
    to them, a few words each.
    """

    path: Path
    vertices: Array
    faces: Array
    sha256: str
    notes: tuple[str, ...] = ()

    def scaled(self, units: Units, scale: float = 1.0) -> tuple[Array, str]:
        """Vertices (V, 3) in m, and the units that they were in; scale: times the file's numbers.

        "auto" takes metres for GLB, else the only unit that gives an object of a `USUAL` size. Raises `DataError` if
        several units do or none does, if the mesh seems to be normalised, and if the stated unit gives a size outside
        `SMALLEST` to `LARGEST`.
        """
        vertices = scale * self.vertices
        longest = float(np.ptp(vertices[np.unique(self.faces)], axis=0).max())
        if longest == 0.0:
            raise DataError(f"{self.path}: all vertices are at the same place; expected a mesh that encloses a volume")
        metres = self.path.suffix.lower() == ".glb"
        if units == "auto" and scale == 1.0 and _NORMALISED[0] <= longest <= _NORMALISED[1]:
            raise DataError(f"{self.path}: the longest side is {longest:.4g}, as of a mesh that was normalised and has "
                            "no unit; state the unit with --units, or the size with --scale (--units m --scale S makes "
                            f"the longest side {longest:.4g} S m)")
        choices = (units,) if units != "auto" else ("m",) if metres else tuple(SCALES)
        low, high = USUAL if units == "auto" and not metres else (SMALLEST, LARGEST)
        fitting = [unit for unit in choices if low <= longest * SCALES[unit] <= high]
        if len(fitting) == 1:
            return vertices * SCALES[fitting[0]], fitting[0]
        allowed = f"expected {100 * low:g} cm to {100 * high:g} cm"
        if len(choices) == 1:
            unit, why = choices[0], ", the unit of glTF" if units == "auto" else ""
            raise DataError(f"{self.path}: the longest side is {longest * SCALES[unit]:.4g} m in {unit}{why}; "
                            f"{allowed}; state another unit with --units ({', '.join(SCALES)}), or scale the mesh with "
                            "--scale")
        if fitting:
            sizes = " or ".join(f"{longest * SCALES[unit]:.3g} m if in {unit}" for unit in fitting)
            raise DataError(f"{self.path}: the longest side is {longest:.4g}: {sizes}; state which with --units")
        raise DataError(f"{self.path}: the longest side is {longest:.4g}, which in {', '.join(SCALES)} is no "
                        f"usual object for a hand; {allowed}; state --units, or scale the mesh with --scale")


def read_mesh_file(path: Path) -> MeshFile:
    """The triangles of an OBJ, STL, PLY or GLB file; from a GLB scene, all meshes at their places in the scene.

    More than `KEPT_FACES` are decimated to that number, with a note. No other file is read: no materials,
    textures or external buffers. Raises `DataError` for a file that is
    missing, of another format, too large, damaged, or without faces, and for vertices that are not finite.
    """
    path = Path(path)
    suffix = path.suffix.lower()[1:]
    if suffix not in FORMATS:
        raise DataError(f"{path}: a file of type {suffix or '(none)'!r}; expected one of {', '.join(FORMATS)}")
    raw = _bytes(path)
    try:
        vertices, faces = _parse(suffix, raw)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    except Exception as error:
        # Readers fail on a damaged file in many ways; to the user they are all the same.
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise DataError(f"{path}: cannot be read as {suffix.upper()} ({reason}); export it again") from None
    if not len(faces):
        raise DataError(f"{path}: it has no faces; expected a surface of triangles or polygons, not points or lines")
    if len(faces) > MAX_FACES:
        raise DataError(f"{path}: {len(faces)} faces; at most {MAX_FACES} are allowed; decimate the mesh first")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise DataError(f"{path}: a face names vertex {int(faces.max())} of {len(vertices)}; export it again")
    bad = int((~np.isfinite(vertices).all(axis=1)).sum())
    if bad:
        raise DataError(f"{path}: {bad} of {len(vertices)} vertices are NaN or infinite; expected finite numbers; "
                        "export it again, or remove them")
    notes: tuple[str, ...] = ()
    if len(faces) > KEPT_FACES:
        before = len(faces)
        vertices, faces = _decimated(vertices, faces)
        notes = (f"decimated from {before} to {len(faces)} faces",)
    return MeshFile(path, vertices, faces, hashlib.sha256(raw).hexdigest(), notes)


def _bytes(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise DataError(f"{path}: {size} bytes; at most {MAX_BYTES} are allowed; decimate the mesh first")
        raw = path.read_bytes()
    except FileNotFoundError:
        raise DataError(f"{path}: no such mesh file") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    if not raw.strip():
        raise DataError(f"{path}: the file is empty; expected a mesh")
    return raw


def _parse(suffix: str, raw: bytes) -> tuple[Array, Array]:
    if suffix == "obj":
        return read_obj(raw)
    if suffix == "stl":
        return read_stl(raw)
    if suffix == "ply":
        return read_ply(raw, _ANNOUNCED)
    return read_glb(raw, MAX_FACES, _ANNOUNCED)


def _decimated(vertices: Array, faces: Array) -> tuple[Array, Array]:
    """The surface with `KEPT_FACES` faces, by quadric decimation of its merged vertices."""
    import fast_simplification
    import trimesh

    span = float(np.ptp(vertices[np.unique(faces)], axis=0).max()) or 1.0
    first, index = trimesh.grouping.unique_rows(np.round(vertices / (1e-7 * span)).astype(np.int64))
    fewer = fast_simplification.simplify(vertices[first], index[faces], target_count=KEPT_FACES)
    return np.asarray(fewer[0], dtype=float), np.asarray(fewer[1], dtype=np.int64)
