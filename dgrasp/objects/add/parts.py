"""Convex parts in place of a concave mesh: cut once by approximate convex decomposition, then kept in a cache.

Engines collide convex bodies several times faster than triangles, and some support nothing else. The settings determine
how close the parts are to the mesh; docs/physics.md gives the difference and its effect on grasps.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import shutil
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.atomic import write_atomic
from dgrasp.files.paths import user_cache_root
from dgrasp.geometry.inertia import load_mesh, mesh_properties
from dgrasp.geometry.inside import union_volume
from dgrasp.types import Array
from raisim_like.shapes import Shape

_FORMAT = 1
"""Increases whenever the files for the same mesh and settings change."""
_MANIFEST = "parts.json"
_SEARCH = {"mcts_iterations": 30, "mcts_nodes": 8, "mcts_max_depth": 2, "seed": 0}
"""Effort of the search for cuts: a tenth of the library's default, for parts as close to the mesh."""
_TOLERANCE = 5e-4
"""Share of a part's longest side. A vertex that is left out protrudes by less than this from the hull of the others."""


@dataclass(frozen=True)
class PartSettings:
    """How finely a mesh is cut.

    threshold: largest concavity of a part, in units of half the mesh's longest side. max_parts, max_vertices: most
    parts, and most vertices of each.
    """

    threshold: float = 0.05
    max_parts: int = 24
    max_vertices: int = 64


def convex_parts(mesh_file: Path, settings: PartSettings | None = None) -> tuple[Shape, ...]:
    """Hulls that together fill the mesh, in its frame; their files exist at least until the process ends.

    The first call for a mesh takes seconds to minutes and says so on standard error. The parts are kept in the
    user's cache folder under a hash of the mesh and the settings. A damaged entry is made again. If the folder cannot
    be written, the parts are kept in a temporary one until the process ends. The same mesh gives the same parts.
    Raises `DataError` for a mesh that is missing, damaged or flat.
    """
    mesh_file = Path(mesh_file)
    settings = settings or PartSettings()
    # Read the mesh first, so that a problem with it is reported even if its parts are in the cache.
    key = _key(_mesh_bytes(mesh_file), settings)
    name = f"parts/{mesh_file.absolute().parent.name}-{key}"
    for root in _roots():
        files = _load(root / name)
        if files:
            return _shapes(files)
    texts = _decompose(mesh_file, settings)
    try:
        return _shapes(_store(user_cache_root() / name, texts))
    except DataError as error:
        _say(f"{error}; the parts stay in a temporary folder for this run (set DGRASP_CACHE to a folder to keep them)")
        return _shapes(_store(_temporary_root() / name, texts))


def _shapes(files: list[Path]) -> tuple[Shape, ...]:
    return tuple(Shape("hull", file=file) for file in files)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _mesh_bytes(mesh_file: Path) -> bytes:
    try:
        return mesh_file.read_bytes()
    except FileNotFoundError:
        raise DataError(f"{mesh_file}: this mesh does not exist; expected one to cut into convex parts") from None
    except OSError as error:
        raise DataError(f"{mesh_file}: cannot be read ({error.strerror or error})") from None


def _library_version() -> str:
    try:
        return version("coacd")
    except PackageNotFoundError:
        raise DataError(
            "convex parts of a mesh need the package coacd, which is not installed: pip install coacd, or keep the "
            "triangles with physics.concave=mesh (pybullet only)"
        ) from None


def _key(mesh: bytes, settings: PartSettings) -> str:
    """A hash of what determines the parts: the mesh, the settings, the library and how it searches."""
    made_by = {"format": _FORMAT, "coacd": _library_version(), "search": _SEARCH, "tolerance": _TOLERANCE}
    text = json.dumps({**made_by, **asdict(settings)}, sort_keys=True)
    return hashlib.sha256(hashlib.sha256(mesh).digest() + text.encode()).hexdigest()[:16]


# The cache: one file per part, named by its content, and a manifest that is written last. Processes that make the same
# entry at the same time never write different content under the same name.


@cache
def _temporary_root() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="dgrasp-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _roots() -> list[Path]:
    """Where parts may be: the user's cache, and the temporary folder if this process has one."""
    return [user_cache_root(), *([_temporary_root()] if _temporary_root.cache_info().currsize else [])]


def _digest(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()[:16]


def _load(folder: Path) -> list[Path]:
    """The files of an entry's parts; none if it is absent, incomplete or damaged."""
    try:
        names = json.loads((folder / _MANIFEST).read_text(encoding="utf-8"))["parts"]
        files = [folder / f"{name}.obj" for name in names]
        whole = all(_digest(file.read_bytes()) == file.stem.split("-")[1] for file in files)
    except (OSError, ValueError, LookupError, TypeError):
        return []
    return files if whole else []


def _store(folder: Path, texts: list[str]) -> list[Path]:
    folder = folder.absolute()
    names = [f"{i:02d}-{_digest(text.encode())}" for i, text in enumerate(texts)]
    files = [folder / f"{name}.obj" for name in names]
    for file, text in zip(files, texts, strict=True):
        write_atomic(file, text)
    write_atomic(folder / _MANIFEST, json.dumps({"parts": names}, indent=1) + "\n")
    return files


# The decomposition.


def _decompose(mesh_file: Path, settings: PartSettings) -> list[str]:
    """The parts of a mesh, each as the text of an OBJ file."""
    mesh = load_mesh(mesh_file)
    volume = mesh_properties(mesh_file).volume
    label = mesh_file.absolute().parent.name
    _say(f"{label}: cutting {mesh_file.name} into convex parts, once; seconds to minutes")
    started = time.monotonic()
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)
    hulls = [reduced_hull(points, settings.max_vertices) for points in _run_coacd(vertices, faces, settings)]
    texts = [obj_text(*hull) for hull in hulls if hull is not None]
    if not texts:
        raise DataError(f"{mesh_file}: no convex parts were found; expected a mesh that encloses a volume")
    with tempfile.TemporaryDirectory() as folder:
        error = union_volume(_shapes(_store(Path(folder), texts))) / volume - 1.0
    compared = f"volume {error:+.0%} against the mesh" if mesh.is_volume else "the mesh is open and has no volume"
    _say(f"{label}: {len(texts)} parts in {time.monotonic() - started:.0f} s, {compared}")
    return texts


def _run_coacd(vertices: Array, faces: Array, settings: PartSettings) -> list[Array]:
    """Points (n, 3) of each part of a mesh with vertices (V, 3) and faces (F, 3)."""
    import coacd  # Imported late: it is needed once per mesh.

    coacd.set_log_level("off")
    found = coacd.run_coacd(
        coacd.Mesh(vertices, faces), threshold=settings.threshold, max_convex_hull=settings.max_parts, **_SEARCH
    )
    return [np.asarray(points, dtype=float) for points, _ in found]


def reduced_hull(points: Array, max_vertices: int) -> tuple[Array, Array] | None:
    """Vertices (V, 3) and outward faces (F, 3) of nearly the convex hull of points (N, 3); None if it is flat.

    Vertices are added one by one, always the point farthest outside the current hull, until no point is outside by more
    than 1/2000 of the longest side or there are `max_vertices`.
    """
    from scipy.spatial import ConvexHull, QhullError

    tolerance = _TOLERANCE * float(np.ptp(points, axis=0).max())
    try:
        corners = points[ConvexHull(points).vertices]
        chosen = _spanning_four(corners)
        while True:
            hull = ConvexHull(corners[chosen])
            beyond = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
            if len(chosen) >= max_vertices or beyond.max() <= tolerance:
                break
            chosen.append(int(beyond.argmax()))
    except QhullError:
        return None
    kept = corners[chosen]
    triangles = kept[hull.simplices]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    # A point that was added early may lie inside the final hull.
    used, numbers = np.unique(faces, return_inverse=True)
    return kept[used], numbers.reshape(faces.shape)


def _spanning_four(points: Array) -> list[int]:
    """Indices of four points (N, 3) far apart; they span a volume if the points do."""
    first = int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())
    away = points - points[first]
    second = int(np.linalg.norm(away, axis=1).argmax())
    third = int(np.linalg.norm(np.cross(away, away[second]), axis=1).argmax())
    fourth = int(np.abs(away @ np.cross(away[second], away[third])).argmax())
    return [first, second, third, fourth]


def obj_text(vertices: Array, faces: Array) -> str:
    """Vertices (V, 3) and faces (F, 3) as the text of a Wavefront file, with nine digits."""
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in vertices.tolist()]
    lines += ["f {} {} {}".format(*face) for face in (faces + 1).tolist()]
    return "\n".join(lines) + "\n"
