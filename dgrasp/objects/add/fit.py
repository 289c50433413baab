"""Choose a solid's collision shapes: a box, cylinder, sphere or capsule if one fits, else convex parts.

The volume overlap |A and B| / |A or B| (intersection over union), by booleans, chooses among the primitives. The
distances between the surfaces refuse one that leaves out a handle or fills a hollow.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dgrasp.config.names import OVERLAP, PRIMITIVES
from dgrasp.errors import DataError
from dgrasp.files.atomic import write_atomic
from dgrasp.geometry.approximate import fit_box, fit_capsule
from dgrasp.geometry.inside import inner_points
from dgrasp.geometry.intersection import body
from dgrasp.geometry.part_mesh import PartMesh
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.objects.add.judge import Gaps, judge
from dgrasp.objects.add.parts import obj_text, part_hulls
from dgrasp.objects.add.repair import RepairedSolid
from dgrasp.types import Array
from raisim_like.rotations import quaternion_from_matrix, transform
from raisim_like.shapes import Kind, Shape
from raisim_like.urdf import shape_pose

Choice = Literal["auto", "box", "cylinder", "sphere", "capsule", "parts", "mesh"]
COLLISION_FILE = "collision.obj"
FARTHEST = 0.007
"""Largest distance between the surfaces of a solid and of a primitive that is taken, m."""
SHARE_CLOSE = 0.95
"""Share of the surfaces within 2 mm below which parts are made again, finer."""
COLLISION_FACES = 2000
"""Triangles of the mesh that collides; more if its surface would move too far (`simplified`)."""
_FIT_FACES, _FIT_POINTS = 3000, 6000
_EXACT = 0.998
"""Overlap above which no better shape is sought."""
_FIT_ERROR, _OFF_AXIS = 0.01, 0.02
"""Overlap, and share of a round shape's radius, by which a fit to counted points may be off."""


@dataclass(frozen=True)
class FittedShapes:
    """The shapes that stand for a solid, in its frame.

    kind: the kind that was chosen. overlap: that of the shapes' union with the solid. tried: the overlap of every kind
    that was tried. gaps: the distances between the surfaces.
    """

    kind: str
    shapes: tuple[Shape, ...]
    overlap: float
    tried: dict[str, float]
    gaps: Gaps


def fit_shapes(solid: RepairedSolid, folder: Path, choice: Choice = "auto", threshold: float = OVERLAP) -> FittedShapes:
    """The shapes for a solid. Files that they need are written to `folder`.

    choice: "auto" takes the primitive with the largest overlap if it reaches `threshold` and its surface is nowhere
    farther than `FARTHEST` from the solid's, else convex parts; any other choice takes that kind. Raises `DataError` if
    that kind cannot be fitted.
    """
    tried: dict[str, float] = {}
    kinds = PRIMITIVES if choice == "auto" else (choice,) if choice in PRIMITIVES else ()
    fits = {kind: made for kind in kinds if (made := fit_primitive(solid, kind)) is not None}
    tried |= {kind: overlap for kind, (_, overlap) in fits.items()}
    best = max(fits, key=lambda kind: tried[kind], default="")
    if best and (choice != "auto" or tried[best] >= threshold):
        gaps = judge(solid, (fits[best][0],))
        if choice != "auto" or gaps.largest <= FARTHEST:
            return FittedShapes(best, (fits[best][0],), tried[best], tried, gaps)
    if choice in PRIMITIVES:
        raise DataError(f"no {choice} can be fitted because the solid is too thin; choose another --shape")
    kind, shapes = ("mesh", (_mesh(solid, folder),)) if choice == "mesh" else ("parts", _parts(solid, folder, False))
    gaps = judge(solid, shapes)
    if kind == "parts" and gaps.share_close < SHARE_CLOSE:
        shapes = _parts(solid, folder, True)
        gaps = judge(solid, shapes)
    tried[kind] = union_overlap(solid, shapes)
    return FittedShapes(kind, shapes, tried[kind], tried, gaps)


def _parts(solid: RepairedSolid, folder: Path, finer: bool) -> tuple[Shape, ...]:
    shapes = []
    for index, hull in enumerate(part_hulls(solid, finer)):
        shapes.append(Shape("hull", file=folder / f"{index:02d}.obj"))
        write_atomic(folder / f"{index:02d}.obj", obj_text(*hull))
    if not shapes:
        raise DataError("no convex parts can be made because the solid is too thin; choose another --shape")
    return tuple(shapes)


def _mesh(solid: RepairedSolid, folder: Path) -> Shape:
    write_atomic(folder / COLLISION_FILE, obj_text(*simplified(solid, COLLISION_FACES).mesh))
    return Shape("mesh", file=folder / COLLISION_FILE)


def simplified(solid: RepairedSolid, faces: int) -> RepairedSolid:
    """The solid with about `faces` triangles, or more if its surface would move by over 1 mm or 1% of its size."""
    size = float(np.ptp(solid.mesh[0], axis=0).max())
    made, tolerance = solid.solid, 1e-5 * size
    while made.num_tri() > faces and tolerance <= min(0.001, 0.01 * size):
        made = solid.solid.simplify(tolerance)
        tolerance *= 2.0
    return RepairedSolid(made, solid.notes)


def union_overlap(solid: RepairedSolid, shapes: Sequence[Shape]) -> float:
    """Intersection over union of a solid and the union of shapes, 0 to 1; 0 if a shape is not a solid."""
    other = body([shape_mesh(shape) for shape in shapes]).solid
    return 0.0 if other is None else _overlap(solid.solid, other)


def _overlap(a: Any, b: Any) -> float:
    common = float((a ^ b).volume())
    # Booleans lose some digits on surfaces that almost coincide.
    return min(1.0, common / (float(a.volume()) + float(b.volume()) - common))


def fit_primitive(solid: RepairedSolid, kind: str) -> tuple[Shape, float] | None:
    """The primitive with the largest overlap, and that overlap; None if none can be fitted.

    The candidates are the bounding shape and one that is fitted to points inside the solid.
    """
    import trimesh
    from scipy.spatial import QhullError

    light = simplified(solid, _FIT_FACES)
    vertices, faces = light.mesh
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    part = PartMesh("object", vertices, faces)
    # The bounding shape is exact for a solid that is such a shape; a fit to counted points is not.
    starts: list[Shape] = []
    with contextlib.suppress(QhullError, ValueError):  # For solids with almost no thickness.
        starts = _bounding(kind, mesh)
    rated = [(union_overlap(light, (shape,)), shape) for shape in starts]
    if not rated or rated[0][0] < _EXACT:
        if kind in ("box", "capsule"):
            with contextlib.suppress(DataError):
                found = fit_box(part) if kind == "box" else fit_capsule(part)
                rated.append((union_overlap(light, (found.shape,)), found.shape))
        elif kind == "cylinder" and starts:
            climbed = _climbed_cylinder(starts[0], mesh)
            rated.append((union_overlap(light, (climbed,)), climbed))
    if not rated:
        return None
    best = max(rated, key=lambda entry: entry[0])[1]
    overlap = union_overlap(solid, (best,))
    for shape in _balanced(best, solid):
        if (reached := union_overlap(solid, (shape,))) >= overlap - _FIT_ERROR:
            return shape, reached
    return best, overlap


def _balanced(shape: Shape, solid: RepairedSolid) -> list[Shape]:
    """A round shape moved sideways onto the solid's centre of mass: turned to the nearest principal axis, and as it is.

    A bar whose centre of mass is off its axis by a few hundredths of a millimetre rolls until it hangs below the axis.
    A turned cylinder ends where the solid ends, so that what stands on its end is not dropped.
    """
    import trimesh

    if shape.kind not in ("cylinder", "capsule", "sphere"):
        return []
    mesh = trimesh.Trimesh(*solid.mesh, process=False)
    center, T = np.asarray(mesh.center_mass), shape_pose(shape)
    away = T[:3, :3].T @ (center - T[:3, 3])
    if np.linalg.norm(away[: 3 if shape.kind == "sphere" else 2]) > _OFF_AXIS * shape.size[0]:
        return []
    if shape.kind == "sphere":
        return [_placed("sphere", shape.size, transform(np.eye(3), center))]
    _, axes = np.linalg.eigh(mesh.moment_inertia)
    nearest = axes[:, np.abs(axes.T @ T[:3, 2]).argmax()]
    nearest *= np.sign(nearest @ T[:3, 2])

    def along(axis: Array, middle: float, size: tuple[float, ...]) -> Shape:
        side = np.cross(T[:3, 1], axis)
        side /= np.linalg.norm(side)
        R = np.stack([side, np.cross(axis, side), axis], axis=1)
        return _placed(shape.kind, size, transform(R, center + axis * middle))

    made = [along(axis, float(axis @ (T[:3, 3] - center)), shape.size) for axis in (nearest, T[:3, 2])]
    if shape.kind == "cylinder":
        heights = (np.asarray(mesh.vertices) - center) @ nearest
        low, high = float(heights.min()), float(heights.max())
        made.insert(0, along(nearest, (low + high) / 2, (shape.size[0], high - low)))
    return made


def _bounding(kind: str, mesh: Any) -> list[Shape]:
    """The bounding box or cylinder of a mesh, the sphere of its volume at its centre of mass, or no capsule."""
    if kind == "box":
        around = mesh.bounding_box_oriented.primitive
        x, y, z = (float(v) for v in around.extents)
        return [_placed("box", (x, y, z), around.transform)]
    if kind == "cylinder":
        around = mesh.bounding_cylinder.primitive
        return [_placed("cylinder", (float(around.radius), float(around.height)), around.transform)]
    if kind == "sphere":
        T = np.eye(4)
        T[:3, 3] = mesh.center_mass
        return [_placed("sphere", (float(3.0 * mesh.volume / (4.0 * math.pi)) ** (1.0 / 3.0),), T)]
    return []


def _climbed_cylinder(start: Shape, mesh: Any) -> Shape:
    """The cylinder near `start` that overlaps most, counted on points inside the mesh."""
    points = inner_points(np.asarray(mesh.vertices), np.asarray(mesh.faces), _FIT_POINTS)
    if len(points) < 100:
        return start
    T, volume = shape_pose(start), float(mesh.volume)
    local = (points - T[:3, 3]) @ T[:3, :3]

    def cost(x: Array) -> float:
        """Minus the overlap, with the axis through x[:3] along (x[3], x[4], 1), radius x[5] and length x[6]."""
        axis = np.array([x[3], x[4], 1.0]) / math.sqrt(1.0 + x[3] ** 2 + x[4] ** 2)
        away = local - x[:3]
        along = away @ axis
        across = np.einsum("ij,ij->i", away, away) - along**2
        inside = (np.abs(along) <= abs(x[6]) / 2) & (across <= x[5] ** 2)
        common = volume * float(np.count_nonzero(inside)) / len(local)
        return -common / (volume + math.pi * x[5] ** 2 * abs(x[6]) - common)

    radius, length = start.size
    x = _climb(cost, np.array([0, 0, 0, 0, 0, radius, length]), np.array([2e-3, 2e-3, 2e-3, 0.05, 0.05, -2e-3, -3e-3]))
    axis = np.array([x[3], x[4], 1.0]) / math.sqrt(1.0 + x[3] ** 2 + x[4] ** 2)
    side = np.cross([0.0, 1.0, 0.0], axis)
    side /= np.linalg.norm(side)
    turned = np.eye(4)
    turned[:3, :3] = np.stack([side, np.cross(axis, side), axis], axis=1)
    turned[:3, 3] = x[:3]
    return _placed("cylinder", (max(abs(float(x[5])), 1e-4), max(abs(float(x[6])), 1e-4)), T @ turned)


def _climb(cost: Callable[[Array], float], start: Array, steps: Array) -> Array:
    from scipy.optimize import minimize

    simplex = np.vstack([start, start + np.diag(steps)])
    found = minimize(cost, start, method="Nelder-Mead",
                     options={"maxiter": 100 * len(start), "initial_simplex": simplex, "xatol": 1e-5, "fatol": 1e-5})
    return np.asarray(found.x)


def _placed(kind: Kind, size: tuple[float, ...], T: Array) -> Shape:
    x, y, z = (float(v) for v in T[:3, 3])
    a, b, c, d = (float(v) for v in quaternion_from_matrix(np.asarray(T[:3, :3])))
    return Shape(kind, size, (x, y, z), (a, b, c, d))
