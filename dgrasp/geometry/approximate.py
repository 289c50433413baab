"""A part's mesh as one simple collision shape: a capsule, a box, or its convex hull; and how well it fits.

The fit maximises the overlap |A and B| / |A or B| of the two solids (intersection over union), estimated on points
inside the mesh. It starts from the principal axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.inertia import MassProperties, shape_properties
from dgrasp.geometry.inside import inner_points, inside_shape
from dgrasp.geometry.part_mesh import PartMesh, mesh_volume
from dgrasp.types import Array
from raisim_like.rotations import quaternion_from_matrix
from raisim_like.shapes import Shape

_FIT_POINTS, _REPORT_POINTS = 6_000, 60_000
_SMALLEST = 1e-4
"""Smallest size of a shape, m."""


@dataclass(frozen=True)
class Fit:
    """A shape for a part. overlap: intersection over union of the shape and the part's mesh, 0 to 1."""

    shape: Shape
    overlap: float


def fit_capsule(part: PartMesh) -> Fit:
    """The capsule that overlaps a part best."""
    points, center, axes, extent = _principal(part)
    axis, length, volume = axes[:, 2], float(extent[2]), part.volume
    # The start has the part's length and volume: pi r^2 length - 2/3 pi r^3, which grows up to r = length / 2 (a ball).
    low, high = 0.0, length / 2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if math.pi * middle**2 * (length - 2 / 3 * middle) < volume else (low, middle)
    half = axis * max(length / 2 - low, _SMALLEST)
    start = np.concatenate([center - half, center + half, [low]])

    def common(x: Array) -> float:
        """Overlap with the capsule between x[:3] and x[3:6] of radius x[6]."""
        bone, radius = x[3:6] - x[:3], abs(x[6])
        squared = max(float(bone @ bone), _SMALLEST**2)
        along = np.clip((points - x[:3]) @ bone / squared, 0.0, 1.0)
        away = points - x[:3] - along[:, None] * bone
        inside = np.einsum("ij,ij->i", away, away) <= radius**2
        return _union(inside, volume, math.pi * radius**2 * (math.sqrt(squared) + 4.0 / 3.0 * radius))

    best, _ = _climb(common, start, np.array([2e-3] * 6 + [1e-3]))
    shape = _capsule(best)
    return Fit(shape, overlap(shape, part))


def fit_box(part: PartMesh) -> Fit:
    """The box that overlaps a part best."""
    from scipy.spatial.transform import Rotation

    points, center, axes, _ = _principal(part)
    volume = part.volume
    found = []
    # If a part is nearly as broad as long, its principal axes in that plane are arbitrary: try three directions.
    for angle in (0.0, math.pi / 6, math.pi / 3):
        frame = axes @ Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()

        def common(x: Array, frame: Array = frame) -> float:
            """Overlap with the box of centre x[:3], lengths x[3:6], turned by x[6:9] from `frame`."""
            local = (points - x[:3]) @ (frame @ Rotation.from_rotvec(x[6:9]).as_matrix())
            inside = (np.abs(local) <= np.abs(x[3:6]) / 2).all(axis=1)
            return _union(inside, volume, float(np.prod(np.abs(x[3:6]))))

        # The start is a box with the points' variances.
        size = np.sqrt(12.0 * ((points - center) @ frame).var(axis=0))
        start = np.concatenate([center, size, np.zeros(3)])
        best, value = _climb(common, start, np.array([3e-3] * 3 + [4e-3] * 3 + [0.1] * 3))
        found.append((value, best, frame))
    _, best, frame = max(found, key=lambda entry: entry[0])
    shape = _box(best, frame)
    return Fit(shape, overlap(shape, part))


def fit_hull(part: PartMesh, file: Path) -> tuple[Fit, PartMesh]:
    """The part's convex hull as a shape that is read from `file`, and the mesh to write there."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(part.vertices)
    except QhullError:
        raise DataError(f"{part.name} is flat; expected a part that encloses a volume") from None
    used, index = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = part.vertices[used], index.reshape(-1, 3).copy()
    inner = vertices.mean(axis=0)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inward = ((a - inner) * np.cross(b - a, c - a)).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    mesh = PartMesh(part.name, vertices, faces)
    # The mesh lies inside its hull, so their intersection has the mesh's volume.
    return Fit(Shape("hull", file=file), part.volume / mesh_volume(vertices, faces)), mesh


def part_properties(part: PartMesh) -> MassProperties:
    """Volume, centre of mass and inertia of a part's mesh at density 1, in the part's frame."""
    import trimesh  # Imported late: it takes a second.

    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    return MassProperties(part.volume, np.array(mesh.center_mass), np.array(mesh.moment_inertia))


def overlap(shape: Shape, part: PartMesh) -> float:
    """Intersection over union of a shape (not a hull) and a part's mesh."""
    inner = inner_points(part.vertices, part.faces, _REPORT_POINTS)
    return _union(inside_shape(shape, inner), part.volume, shape_properties(shape).volume)


def _union(inside: Array, volume: float, other: float) -> float:
    """Intersection over union of a mesh of `volume`, given which of its points are inside the other solid."""
    # Each point stands for its share of the mesh.
    common = volume * float(np.count_nonzero(inside)) / len(inside)
    return common / (volume + other - common)


def _climb(value: Callable[[Array], float], start: Array, steps: Array) -> tuple[Array, float]:
    """The point near `start` (K,) with the largest value, and that value: Nelder-Mead with initial steps (K,)."""
    from scipy.optimize import minimize

    found = minimize(
        lambda x: -value(x), start, method="Nelder-Mead",
        options={"maxiter": 100 * len(start), "initial_simplex": np.vstack([start, start + np.diag(steps)]),
                 "xatol": 1e-5, "fatol": 1e-5},
    )  # fmt: skip
    return found.x, -float(found.fun)


def _principal(part: PartMesh) -> tuple[Array, Array, Array, Array]:
    """Points inside (N, 3), their mean (3,), principal axes as columns by rising variance, and extents along them."""
    points = inner_points(part.vertices, part.faces, _FIT_POINTS)
    if len(points) < 100:
        raise DataError(f"{part.name} is too thin to fit a shape to; expected a part that encloses a volume")
    center = points.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((points - center).T))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1.0
    return points, center, axes, np.ptp(points @ axes, axis=0)


def _capsule(x: Array) -> Shape:
    """The capsule of x: both ends of the straight part (3,) and the radius."""
    axis = x[3:6] - x[:3]
    length = max(float(np.linalg.norm(axis)), _SMALLEST)
    direction = axis / length if length > _SMALLEST else np.array([0.0, 0.0, 1.0])
    side = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(direction, side), direction], axis=1)
    return _placed("capsule", (max(abs(float(x[6])), _SMALLEST), length), (x[:3] + x[3:6]) / 2, frame)


def _box(x: Array, frame: Array) -> Shape:
    """The box of x: centre (3,), full lengths (3,) and a rotation vector (3,) relative to the columns of `frame`."""
    from scipy.spatial.transform import Rotation

    size = tuple(np.maximum(np.abs(x[3:6]), _SMALLEST).tolist())
    return _placed("box", size, x[:3], frame @ Rotation.from_rotvec(x[6:9]).as_matrix())


def _placed(kind: Literal["capsule", "box"], size: tuple[float, ...], center: Array, frame: Array) -> Shape:
    px, py, pz = (float(v) for v in center)
    w, i, j, k = (float(v) for v in quaternion_from_matrix(frame))
    return Shape(kind, size, (px, py, pz), (w, i, j, k))
