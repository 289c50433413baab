"""Read a user's mesh file (OBJ, STL, PLY or GLB) within limits, and give its triangles in metres."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import re
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dgrasp.errors import DataError
from dgrasp.types import Array

FORMATS = ("obj", "stl", "ply", "glb")
MAX_BYTES = 100 * 2**20
MAX_FACES = 500_000
SMALLEST, LARGEST = 0.005, 1.0
"""m. Limits of an object's longest side."""
USUAL = (0.01, 0.5)
"""m. Usual range of the longest side of an object that a hand grasps, from which units are guessed."""

Units = Literal["auto", "m", "cm", "mm"]
SCALES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_ANNOUNCED = 20 * MAX_FACES
"""Most rows that a file's header may announce in all; for more, nothing is allocated."""


@dataclass(frozen=True, eq=False)
class MeshFile:
    """The triangles of a file, unchanged.

    vertices (V, 3), in the file's units; faces (F, 3). sha256: of the file's bytes, hexadecimal.
    """

    path: Path
    vertices: Array
    faces: Array
    sha256: str

    def scaled(self, units: Units) -> tuple[Array, str]:
        """Vertices (V, 3) in m, and the units that they were in.

        "auto" takes the only unit that gives an object of a `USUAL` size. Raises `DataError` if several units do or
        none does, and if the stated unit gives a size outside `SMALLEST` to `LARGEST`.
        """
        sides = np.ptp(self.vertices[np.unique(self.faces)], axis=0)
        longest = float(sides.max())
        if longest == 0.0:
            raise DataError(f"{self.path}: all vertices are at the same place; expected a mesh that encloses a volume")
        choices, (low, high) = ((units,), (SMALLEST, LARGEST)) if units != "auto" else (tuple(SCALES), USUAL)
        fitting = [unit for unit in choices if low <= longest * SCALES[unit] <= high]
        if len(fitting) == 1:
            return self.vertices * SCALES[fitting[0]], fitting[0]
        allowed = f"expected {100 * low:g} cm to {100 * high:g} cm"
        if units != "auto":
            raise DataError(f"{self.path}: the longest side is {longest * SCALES[units]:.4g} m in {units}; {allowed}; "
                            f"state another unit with --units ({', '.join(SCALES)}), or scale the mesh")
        if fitting:
            sizes = " or ".join(f"{longest * SCALES[unit]:.3g} m if in {unit}" for unit in fitting)
            raise DataError(f"{self.path}: the longest side is {longest:.4g}: {sizes}; state which with --units")
        raise DataError(f"{self.path}: the longest side is {longest:.4g}, which in {', '.join(SCALES)} is no "
                        f"usual object for a hand; {allowed}; state --units, or scale the mesh")


def read_mesh_file(path: Path) -> MeshFile:
    """The triangles of an OBJ, STL, PLY or GLB file; from a GLB scene, all meshes at their places in the scene.

    No other file is read: no materials, textures or external buffers. Raises `DataError` for a file that is
    missing, of another format, too large, damaged, or without faces, and for vertices that are not finite.
    """
    path = Path(path)
    suffix = path.suffix.lower()[1:]
    if suffix not in FORMATS:
        raise DataError(f"{path}: a file of type {suffix or '(none)'!r}; expected one of {', '.join(FORMATS)}")
    raw = _bytes(path)
    try:
        _check_header(suffix, raw)
        vertices, faces = _parse(suffix, raw)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    except Exception as error:
        # trimesh's parsers fail on a damaged file in many ways; to the user they are all the same.
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
    return MeshFile(path, vertices, faces, hashlib.sha256(raw).hexdigest())


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
    import trimesh  # Imported late: it takes a second.

    with _silence():
        scene = trimesh.load_scene(io.BytesIO(raw), file_type=suffix, process=False, skip_materials=True)
        # A scene may show one mesh many times, so count its faces before they are copied as often.
        geometries = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
        shown = sum(len(getattr(geometry, "faces", ())) for geometry in geometries)
        if shown > MAX_FACES:
            raise DataError(f"{shown} faces; at most {MAX_FACES} are allowed; decimate the mesh first")
        meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = [np.asarray(mesh.vertices, dtype=float) for mesh in meshes]
    faces = [np.asarray(mesh.faces, dtype=np.int64) + start for mesh, start in zip(meshes, starts, strict=False)]
    return np.concatenate([np.zeros((0, 3)), *vertices]), np.concatenate([np.zeros((0, 3), np.int64), *faces])


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Suppress the library's messages about a damaged file; the error that follows says what the user needs."""
    import trimesh

    logger = trimesh.util.log
    before, logger.disabled = logger.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = before


def _check_header(suffix: str, raw: bytes) -> None:
    """Refuse a file that announces more than it holds or than is allowed, before any memory is allocated for it."""
    if suffix == "stl" and raw.lstrip()[:5].lower() != b"solid":
        if len(raw) < 84:
            raise DataError(f"{len(raw)} bytes, less than the header of a binary STL; the file is cut off")
        count = struct.unpack_from("<I", raw, 80)[0]
        if len(raw) != 84 + 50 * count:
            raise DataError(f"its header announces {count} faces, but there are bytes for {(len(raw) - 84) / 50:g}; "
                            "the file is damaged or cut off")
    elif suffix == "ply":
        head = raw.partition(b"end_header")[0]
        counts = [int(n) for n in re.findall(rb"^element\s+\S+\s+(\d+)\s*$", head, re.MULTILINE)]
        # The shortest row of any element is one byte in binary files, and a digit and a line end in text files.
        if sum(counts) > len(raw):
            raise DataError(f"its header announces {sum(counts)} rows, more than {len(raw)} bytes hold; the file is "
                            "damaged or cut off")
        _check_rows(sum(counts))
    elif suffix == "glb":
        if raw[:4] != b"glTF" or len(raw) < 20:
            raise DataError("it does not begin like a GLB file; expected binary glTF 2.0")
        length, chunk = struct.unpack_from("<II", raw, 8)
        if length != len(raw) or 20 + chunk > length:
            raise DataError(f"its header announces {length} bytes, but there are {len(raw)}; the file is damaged or "
                            "cut off")
        content = json.loads(raw[20 : 20 + chunk])
        accessors = content.get("accessors", []) if isinstance(content, dict) else []
        _check_rows(sum(_count(accessor) for accessor in accessors))


def _count(accessor: Any) -> int:
    count = accessor.get("count") if isinstance(accessor, dict) else None
    if isinstance(count, bool) or not isinstance(count, int) or count < 0:
        raise DataError(f"an accessor counts {str(count)[:50]!r}; expected a number of rows; the file is damaged")
    return count


def _check_rows(rows: int) -> None:
    if rows > _ANNOUNCED:
        raise DataError(f"its header announces {rows} rows; at most {_ANNOUNCED} are allowed; decimate the mesh first")
