"""Convex parts in place of a concave mesh: cut once (`dgrasp.objects.add.cut`), then kept in a cache.

Engines collide convex bodies several times faster than triangles, and some support nothing else. docs/objects.md gives
the distance between parts and meshes, docs/physics.md its effect on grasps.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import shutil
import sys
import tempfile
import time
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.atomic import write_atomic
from dgrasp.files.paths import user_cache_root
from dgrasp.geometry.inertia import load_mesh
from dgrasp.types import Array
from raisim_like.shapes import Shape

if TYPE_CHECKING:
    from dgrasp.objects.add.repair import RepairedSolid

TOLERANCE, LEAST_SHARE = 0.0015, 0.02
"""How far a part may reach beyond the surface, m; less for objects of which it is more than this share of the size."""
MOST_PARTS, MOST_VERTICES = 96, 64
"""Most parts of an object, and most vertices of each."""
_FINER, MOST_FINER_PARTS = 0.8, 144
"""Share of the tolerance, and most parts, of an object that the usual ones do not meet well."""
_SLACK = 0.1
"""Share of the tolerance by which a surface may move when its triangles and the parts' vertices are thinned out."""
_FORMAT = 2
"""Increases whenever the files for the same mesh change."""
_MANIFEST = "parts.json"


def convex_parts(mesh_file: Path) -> tuple[Shape, ...]:
    """Hulls that together fill the mesh, in its frame; their files exist at least until the process ends.

    The first call for a mesh takes up to a minute and says so on standard error. The parts are kept in the user's
    cache folder under a hash of the mesh. A damaged entry is made again. If the folder cannot be written, the parts are
    kept in a temporary one until the process ends. The same mesh gives the same parts. Raises `DataError` for a mesh
    that is missing or damaged, or encloses no volume.
    """
    mesh_file = Path(mesh_file)
    # Read the mesh first, so that a problem with it is reported even if its parts are in the cache.
    name = f"parts/{mesh_file.absolute().parent.name}-{_key(_mesh_bytes(mesh_file))}"
    for root in _roots():
        files = _load(root / name)
        if files:
            return _shapes(files)
    texts = _decompose(mesh_file)
    try:
        return _shapes(_store(user_cache_root() / name, texts))
    except DataError as error:
        _say(f"{error}; the parts stay in a temporary folder for this run (set DGRASP_CACHE to a folder to keep them)")
        return _shapes(_store(_temporary_root() / name, texts))


def part_hulls(solid: RepairedSolid, finer: bool = False) -> list[tuple[Array, Array]]:
    """Vertices (V, 3) m and outward faces (F, 3) of the convex parts of a solid; none if it is too thin for any.

    finer: a smaller tolerance and more parts.
    """
    from dgrasp.objects.add.cut import cut  # Imported late: it takes a second, and parts are mostly in the cache.

    tolerance = min(TOLERANCE, LEAST_SHARE * float(np.ptp(solid.mesh[0], axis=0).max()))
    tolerance, most = (_FINER * tolerance, MOST_FINER_PARTS) if finer else (tolerance, MOST_PARTS)
    slack = _SLACK * tolerance
    pieces = cut(solid.solid.simplify(slack), tolerance, most)
    hulls = [reduced_hull(points, MOST_VERTICES, slack) for points in pieces]
    return [hull for hull in hulls if hull is not None]


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


def _key(mesh: bytes) -> str:
    """A hash of what determines the parts: the mesh, the format and the libraries."""
    made_by = {"format": _FORMAT, "libraries": [version(name) for name in ("manifold3d", "scipy")]}
    return hashlib.sha256(hashlib.sha256(mesh).digest() + json.dumps(made_by).encode()).hexdigest()[:16]


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


def _decompose(mesh_file: Path) -> list[str]:
    """The parts of a mesh, each as the text of an OBJ file."""
    from dgrasp.objects.add.judge import CLOSE, judge
    from dgrasp.objects.add.repair import repair

    mesh = load_mesh(mesh_file)
    try:
        solid = repair(np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces))
    except DataError as error:
        raise DataError(f"{mesh_file}: {error}") from None
    label = mesh_file.absolute().parent.name
    _say(f"{label}: cutting {mesh_file.name} into convex parts, once; up to a minute")
    started = time.monotonic()
    texts = [obj_text(*hull) for hull in part_hulls(solid)]
    if not texts:
        raise DataError(f"{mesh_file}: no convex parts were found; expected a mesh that encloses a volume")
    with tempfile.TemporaryDirectory() as folder:
        close = judge(solid, _shapes(_store(Path(folder), texts))).share_close
    _say(f"{label}: {len(texts)} parts in {time.monotonic() - started:.0f} s, {close:.1%} of the surface within "
         f"{1000 * CLOSE:g} mm")
    return texts


def reduced_hull(points: Array, max_vertices: int, slack: float) -> tuple[Array, Array] | None:
    """Vertices (V, 3) and outward faces (F, 3) of nearly the convex hull of points (N, 3); None if it is flat.

    Vertices are added one by one, always the point farthest outside the current hull, until no point is outside by more
    than `slack` (m) or there are `max_vertices`.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = points[ConvexHull(points).vertices]
        chosen = _spanning_four(corners)
        while True:
            hull = ConvexHull(corners[chosen])
            beyond = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
            if len(chosen) >= max_vertices or beyond.max() <= slack:
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
