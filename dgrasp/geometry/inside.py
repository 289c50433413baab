"""Which points lie inside a shape or a closed mesh, and the bounds and the union volume of shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape


def inside_shape(shape: Shape, points: Array) -> Array:
    """(N,) bool: which points (N, 3), in the frame of the shape's body, lie in it.

    Hulls and meshes are read from their files; a mesh counts as its convex hull.
    """
    local = (points - np.array(shape.position)) @ matrix_from_quaternion(np.array(shape.quaternion))
    if shape.kind == "box":
        return np.asarray((np.abs(local) <= np.array(shape.size) / 2).all(axis=1))
    if shape.kind == "sphere":
        return np.asarray((local**2).sum(axis=1) <= shape.size[0] ** 2)
    if shape.kind in ("capsule", "cylinder"):
        radius, length = shape.size
        along, across = np.abs(local[:, 2]), (local[:, :2] ** 2).sum(axis=1)
        if shape.kind == "cylinder":
            return np.asarray((along <= length / 2) & (across <= radius**2))
        return np.asarray(across + np.maximum(along - length / 2, 0.0) ** 2 <= radius**2)
    if shape.file is None:
        raise ValueError(f"a shape of kind {shape.kind!r} needs a file")
    from dgrasp.geometry.inertia import load_mesh

    return inside_hull(np.asarray(load_mesh(shape.file, shape.scale).vertices), local)


def inside_hull(vertices: Array, points: Array) -> Array:
    """(N,) bool: which points (N, 3) lie in the convex hull of vertices (V, 3)."""
    from scipy.spatial import ConvexHull

    planes = ConvexHull(vertices).equations
    return np.asarray((points @ planes[:, :3].T + planes[:, 3] <= 1e-12).all(axis=1))


def inner_points(vertices: Array, faces: Array, count: int) -> Array:
    """The points (N, 3) that lie in a closed mesh, of about `count` spread evenly over its bounding box.

    vertices (V, 3), faces (F, 3), wound outwards. A point is inside if a ray from it along x leaves the mesh more
    often than it enters. This also holds where the surface cuts through itself.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    along, columns = _columns(low, high, count)
    crossings = np.zeros((along.shape[1] + 1, len(columns)), dtype=np.int64)
    y, z = columns.T
    corners = vertices[faces]
    starts, first, second = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = first[:, 1] * second[:, 2] - first[:, 2] * second[:, 1]
    for a, e, f, area in zip(starts, first, second, areas, strict=True):
        if abs(area) < 1e-18:
            continue
        # Where the column crosses the triangle, in multiples of the triangle's two sides.
        u = ((y - a[1]) * f[2] - (z - a[2]) * f[1]) / area
        v = ((z - a[2]) * e[1] - (y - a[1]) * e[2]) / area
        hit = np.flatnonzero((u > 0) & (v > 0) & (u + v < 1))
        x = a[0] + u[hit] * e[0] + v[hit] * f[0]
        # Each point before the crossing sees one more exit, or one more entry.
        before = (along[hit] < x[:, None]).sum(axis=1)
        crossings[before, hit] += 1 if area > 0 else -1
    exits = crossings[::-1].cumsum(axis=0)[::-1][1:]
    column, place = np.nonzero(exits.T > 0)
    return np.column_stack([along[column, place], columns[column]])


def box_points(low: Array, high: Array, count: int) -> Array:
    """About `count` points (N, 3) spread evenly over the box from low to high (3,)."""
    along, columns = _columns(low, high, count)
    return np.column_stack([along.reshape(-1), np.repeat(columns, along.shape[1], axis=0)])


def _columns(low: Array, high: Array, count: int) -> tuple[Array, Array]:
    """Columns along x: the points' x (C, K) and the columns' y, z (C, 2).

    A Kronecker sequence (generalised golden ratios) places them instead of a grid: a box could fit between the layers
    of a grid and would look better than it is.
    """
    size = np.maximum(high - low, 1e-9)
    edge = float(np.prod(size) / count) ** (1.0 / 3.0)
    per_column = max(1, round(size[0] / edge))
    n = max(1, round(count / per_column))
    golden = 1.0 / 1.2207440846057596 ** np.arange(1, 4)
    phase = (0.5 + np.outer(np.arange(n), golden)) % 1.0
    along = low[0] + size[0] * (np.arange(per_column) + phase[:, :1]) / per_column
    return along, low[1:] + size[1:] * phase[:, 1:]


def shape_bounds(shape: Shape) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of a box around the shape, in the frame of its body."""
    R = matrix_from_quaternion(np.array(shape.quaternion))
    if shape.kind in ("hull", "mesh"):
        from dgrasp.geometry.inertia import load_mesh

        assert shape.file is not None
        placed = np.asarray(load_mesh(shape.file, shape.scale).vertices) @ R.T + np.array(shape.position)
        return placed.min(axis=0), placed.max(axis=0)
    if shape.kind == "box":
        half = np.abs(R) @ (np.array(shape.size) / 2)
    elif shape.kind == "sphere":
        half = np.full(3, shape.size[0])
    else:
        # A cylinder gets the box of its capsule, which is large enough.
        half = np.abs(R[:, 2]) * shape.size[1] / 2 + shape.size[0]
    return np.array(shape.position) - half, np.array(shape.position) + half


def union_volume(shapes: Sequence[Shape], count: int = 60_000) -> float:
    """Volume in m^3 of the union of shapes of one body, by counting points; the error is about 1% for 60,000 points."""
    bounds = [shape_bounds(shape) for shape in shapes]
    low, high = np.min([b[0] for b in bounds], axis=0), np.max([b[1] for b in bounds], axis=0)
    points = box_points(low, high, count)
    inside = np.any([inside_shape(shape, points) for shape in shapes], axis=0)
    return float(inside.mean() * np.prod(high - low))
