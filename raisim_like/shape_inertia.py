"""Mass, centre of mass and inertia of collision shapes of one density, for links whose file states none."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape

Array = NDArray[Any]
DENSITY = 1000.0
"""kg/m^3: that of water, and nearly that of flesh and plastics."""


def shape_inertia(shape: Shape) -> tuple[float, Array, Array]:
    """Mass kg, centre of mass (3,) m and inertia (3, 3) kg m^2 about it, in the shape's body's frame and axes.

    A hull is that of its file's vertices; without a volume it has no mass. Raises ValueError for a file whose vertices
    cannot be read.
    """
    R = matrix_from_quaternion(np.array(shape.quaternion))
    volume, center, second = _moments(shape)
    # From the second moments, the integral of x x^T, to the inertia tr(S) 1 - S.
    local = np.trace(second) * np.eye(3) - second
    return DENSITY * volume, R @ center + np.array(shape.position), DENSITY * (R @ local @ R.T)


def _moments(shape: Shape) -> tuple[float, Array, Array]:
    """Volume, centre, and the second moments (3, 3) about the centre, in the shape's own frame."""
    if shape.kind == "box":
        size = np.array(shape.size)
        volume = float(size.prod())
        return volume, np.zeros(3), np.diag(volume * size**2 / 12.0)
    if shape.kind == "hull":
        return _hull_moments(shape)
    radius = shape.size[0]
    ball = 4.0 / 3.0 * np.pi * radius**3
    if shape.kind == "sphere":
        return ball, np.zeros(3), ball * radius**2 / 5.0 * np.eye(3)
    length = shape.size[1]
    tube = np.pi * radius**2 * length
    across, along = tube * radius**2 / 4.0, tube * length**2 / 12.0
    if shape.kind == "cylinder":
        return tube, np.zeros(3), np.diag([across, across, along])
    # Half balls, whose centres lie 3/8 of the radius beyond the ends of the tube.
    caps = ball * (radius**2 / 5.0 + length**2 / 4.0 + 3.0 / 8.0 * length * radius)
    across += ball * radius**2 / 5.0
    return tube + ball, np.zeros(3), np.diag([across, across, along + caps])


def _hull_moments(shape: Shape) -> tuple[float, Array, Array]:
    from scipy.spatial import ConvexHull, QhullError

    points = obj_vertices(shape) * np.array(shape.scale)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return 0.0, np.zeros(3), np.zeros((3, 3))
    inner = points[hull.vertices].mean(axis=0)
    # The tetrahedra from an inner point to the faces; their orientation does not matter.
    corners = points[hull.simplices] - inner
    volumes = np.abs(np.linalg.det(corners)) / 6.0
    volume = float(volumes.sum())
    center = volumes @ corners.sum(axis=1) / 4.0 / volume
    sums = corners.sum(axis=1)
    second = np.einsum("n,nki,nkj->ij", volumes, corners, corners) + np.einsum("n,ni,nj->ij", volumes, sums, sums)
    return volume, center + inner, second / 20.0 - volume * np.outer(center, center)


def obj_vertices(shape: Shape) -> Array:
    """(V, 3) m: the vertices of a shape's .obj file, not scaled."""
    if shape.file is None or shape.file.suffix.lower() != ".obj":
        raise ValueError(f"{shape.file}: no .obj file, whose vertices could be read")
    try:
        lines = shape.file.read_text(encoding="utf-8", errors="replace").splitlines()
        rows = [[float(word) for word in line.split()[1:4]] for line in lines if line.split()[:1] == ["v"]]
        points = np.array(rows, dtype=float).reshape(-1, 3)
    except (OSError, ValueError) as error:
        raise ValueError(f"{shape.file}: cannot be read ({error})") from None
    return points
