"""Polygons of any number of corners as triangles, also those that are not convex."""

from __future__ import annotations

import numpy as np

from dgrasp.errors import DataError
from dgrasp.types import Array


def triangulated(vertices: Array, corners: Array, counts: Array) -> Array:
    """(F, 3) triangles of polygons, in the polygons' winding.

    vertices: (V, 3). corners: (C,) vertex numbers of all polygons, one polygon after another. counts: (P,) corners of
    each polygon. Polygons of one or two corners (points and lines) are left out. A polygon that is not convex is cut
    in the plane of its normal. Raises `DataError` for a corner that is no vertex.
    """
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
        wrong = int(corners.max() if corners.max() >= len(vertices) else corners.min())
        raise DataError(f"a face names vertex {wrong} (counted from 0) of {len(vertices)}; export it again")
    starts = np.cumsum(counts) - counts
    found: list[Array] = [np.zeros((0, 3), dtype=np.int64)]
    for count in np.unique(counts[counts >= 3]):
        polygons = corners[starts[counts == count][:, None] + np.arange(count)]
        if count == 3:
            found.append(polygons)
            continue
        concave = _concave(vertices[polygons])
        fans = polygons[~concave]
        found += [fans[:, [0, k, k + 1]] for k in range(1, count - 1)]
        found += [_cut(vertices, polygon) for polygon in polygons[concave]]
    return np.concatenate(found).astype(np.int64)


def _normals(points: Array) -> Array:
    """(P, 3) normals of polygons (P, n, 3), as long as twice their area."""
    around = points - points[:, :1]
    return np.asarray(np.cross(around, np.roll(around, -1, axis=1)).sum(axis=1))


def _concave(points: Array) -> Array:
    """(P,) bool: whether a polygon (P, n, 3) turns against its normal at a corner."""
    edges = np.roll(points, -1, axis=1) - points
    turns = np.einsum("pni,pi->pn", np.cross(np.roll(edges, 1, axis=1), edges), _normals(points))
    return np.asarray((turns < -1e-9 * np.abs(turns).max(axis=1, keepdims=True)).any(axis=1))


def _cut(vertices: Array, polygon: Array) -> Array:
    """(F, 3) triangles of one polygon (n,) that is not convex."""
    import manifold3d

    points = vertices[polygon]
    axes = np.linalg.svd(_normals(points[None]))[2]
    flat = np.ascontiguousarray((points - points[0]) @ axes[1:].T)
    # The plane's axes may show the polygon from behind.
    turned = float(np.linalg.det(axes) * (axes[0] @ _normals(points[None])[0])) < 0.0
    order = np.arange(len(polygon))[::-1] if turned else np.arange(len(polygon))
    triangles = np.asarray(manifold3d.triangulate([flat[order]]), dtype=np.int64)
    if len(triangles) != len(polygon) - 2:  # A polygon that crosses itself.
        return polygon[[[0, k, k + 1] for k in range(1, len(polygon) - 1)]]
    triangles = order[triangles]
    return polygon[triangles[:, ::-1] if turned else triangles]
