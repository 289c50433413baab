"""Solids from which to build meshes: turned, lofted, swept and cut. Each is a `manifold3d.Manifold` in m."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dgrasp.types import Array

CORNERS = 48
"""Corners of a circle."""

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]


def turned(profile: Sequence[Point2]) -> Any:
    """The solid of revolution about z of a closed outline of points (radius, z)."""
    import manifold3d

    return manifold3d.Manifold.revolve(manifold3d.CrossSection([np.array(profile)]), CORNERS)


def plate(outline: Any, height: float, low: float = 0.0) -> Any:
    """An outline (`manifold3d.CrossSection`) extruded along z from `low` to `low + height`."""
    import manifold3d

    return manifold3d.Manifold.extrude(outline, height).translate((0.0, 0.0, low))


def rounded(*discs: tuple[float, float, float]) -> Any:
    """The convex outline around discs (x, y, radius)."""
    import manifold3d

    circles = [manifold3d.CrossSection.circle(r, CORNERS).translate((x, y)) for x, y, r in discs]
    return manifold3d.CrossSection.batch_hull(circles)


def block(size: Point3, center: Point3 = (0.0, 0.0, 0.0), bevel: float = 0.0) -> Any:
    """A box, its edges cut off where `bevel` (m) is positive."""
    import manifold3d

    if bevel == 0.0:
        return manifold3d.Manifold.cube(size, True).translate(center)
    inner = np.array(size) - 2.0 * bevel
    cores = [manifold3d.Manifold.cube(tuple(np.where(np.arange(3) == k, size, inner)), True) for k in range(3)]
    return manifold3d.Manifold.batch_hull(cores).translate(center)


def lofted(sections: Sequence[tuple[float, float, float, float]]) -> Any:
    """A body along z through superellipses (z, half width x, half depth y, exponent); exponent 2 is an ellipse."""
    angle = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    cos, sin = np.cos(angle), np.sin(angle)
    rings = []
    for z, a, b, n in sections:
        x, y = (half * np.sign(v) * np.abs(v) ** (2.0 / n) for half, v in ((a, cos), (b, sin)))
        rings.append(np.stack([x, y, np.full(CORNERS, z)], axis=1))
    return _skinned(np.array(rings), closed=False)


def swept(points: Array, radii: Array, up: Point3, closed: bool = False) -> Any:
    """A tube along a plane curve through points (n, 3) with radii (n,); `up` is the plane's normal."""
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0) if closed else np.gradient(points, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    normal = np.array(up) / np.linalg.norm(up)
    side = np.cross(ahead, normal)
    angle = 2.0 * np.pi * np.arange(CORNERS // 3) / (CORNERS // 3)
    # Side, normal and the direction ahead are left-handed, hence the minus.
    ring = np.cos(angle)[:, None] * side[:, None] - np.sin(angle)[:, None] * normal
    return _skinned(points[:, None] + radii[:, None, None] * ring, closed)


def smooth(points: Sequence[Sequence[float]]) -> Array:
    """(n, d): a smooth curve from the first to the last of points (k, d): their polygon, corners cut thrice."""
    curve = np.array(points, dtype=float)
    for _ in range(3):
        first, second = curve[:-1] * 0.75 + curve[1:] * 0.25, curve[:-1] * 0.25 + curve[1:] * 0.75
        inner = np.stack([first, second], axis=1).reshape(-1, curve.shape[1])
        curve = np.concatenate([curve[:1], inner[1:-1], curve[-1:]])
    return curve


def _skinned(rings: Array, closed: bool) -> Any:
    """The solid whose skin runs over rings (n, m, 3), each counter-clockwise seen from the next ones."""
    import manifold3d

    n, m, _ = rings.shape
    i, j = np.meshgrid(np.arange(n if closed else n - 1), np.arange(m), indexing="ij")
    a, b = i * m + j, i * m + (j + 1) % m
    c, d = (i + 1) % n * m + j, (i + 1) % n * m + (j + 1) % m
    faces: list[Array] = [np.stack([a, b, d], axis=-1).reshape(-1, 3), np.stack([a, d, c], axis=-1).reshape(-1, 3)]
    vertices = rings.reshape(-1, 3)
    if not closed:
        k, after = np.arange(m), (np.arange(m) + 1) % m
        first, last = np.full(m, n * m), np.full(m, n * m + 1)
        faces += [np.stack([first, after, k], axis=1),
                  np.stack([last, (n - 1) * m + k, (n - 1) * m + after], axis=1)]
        vertices = np.concatenate([vertices, rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]])
    triangles = np.ascontiguousarray(np.concatenate(faces), dtype=np.uint64)
    return manifold3d.Manifold(manifold3d.Mesh64(np.ascontiguousarray(vertices), triangles))
