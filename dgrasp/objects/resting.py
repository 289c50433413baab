"""How any object comes to rest on a table: on the faces of its convex hull that its weight does not tip it from."""

from __future__ import annotations

import math

import numpy as np

from dgrasp.types import Array

STABLE_DEG = 7.0
"""A resting object is tipped over by no smaller angle."""
_SAME_FACE = 1e-3
_SHARE = 0.1


def resting_rotations(vertices: Array, center: Array) -> tuple[Array, Array]:
    """(K, 3, 3) rotations R_WO in which a body rests on a horizontal table, and (K,) how probable each is.

    vertices (V, 3) and centre of mass (3,), m, in O. The larger the angle that tips it over, the more probable; faces
    of less than a tenth of the best one's probability are left out. A body that rests nowhere stands as in O.
    """
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vertices)
    found: list[tuple[Array, float]] = []
    left = np.ones(len(hull.equations), bool)
    for i in range(len(left)):
        if not left[i]:
            continue
        same = (np.abs(hull.equations[:, :3] @ hull.equations[i, :3] - 1.0) < _SAME_FACE) & left
        left &= ~same
        normal = hull.equations[i, :3]
        R = turn_down(normal)
        angle = _tipping(vertices[np.unique(hull.simplices[same])] @ R.T, R @ center)
        if angle >= math.radians(STABLE_DEG):
            found.append((R, angle))
    if not found:
        return np.eye(3)[None], np.ones(1)
    weights = np.array([angle for _, angle in found]) ** 2
    kept = weights >= _SHARE * weights.max()
    return np.stack([R for R, _ in found])[kept], weights[kept] / weights[kept].sum()


def turn_down(normal: Array) -> Array:
    """(3, 3): the smallest rotation that makes a unit vector (3,) point down."""
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    sine, cosine = float(np.linalg.norm(axis)), -float(normal[2])
    if sine < 1e-9:
        return np.eye(3) if cosine > 0.0 else np.diag([1.0, -1.0, -1.0])
    x, y, z = axis / sine
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross))


def _tipping(support: Array, center: Array) -> float:
    """rad by which a body that stands on points (S, 3) tips over its nearest edge; negative where it stands not."""
    from scipy.spatial import ConvexHull, QhullError

    height = max(float(center[2] - support[:, 2].min()), 1e-6)
    try:
        edges = ConvexHull(support[:, :2]).equations
    except QhullError:
        return -1.0
    inside = float((-edges[:, :2] @ center[:2] - edges[:, 2]).min())
    return math.atan2(inside, height)
