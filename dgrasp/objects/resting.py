"""How an object comes to rest on a table: on a face of its convex hull from which its weight does not tip it."""

from __future__ import annotations

import math

import numpy as np

from dgrasp.types import Array

STABLE_DEG = 7.0
"""Smallest angle that may tip a resting object over, degrees."""
_SAME_FACE = 1e-3
_SHARE = 0.1


def resting_rotations(vertices: Array, center: Array) -> tuple[Array, Array]:
    """(K, 3, 3) rotations R_WO in which a body rests on a horizontal table, and (K,) how probable each is.

    vertices (V, 3) and centre of mass (3,), m, in O. The larger the angle that tips the body over, the more probable
    the face. Faces with less than a tenth of the highest probability are left out. A body without a stable face stands
    as in O.
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
    """Angle (rad) that tips a body on points (S, 3) over its nearest edge; negative if the body cannot stand."""
    from scipy.spatial import ConvexHull, QhullError

    height = max(float(center[2] - support[:, 2].min()), 1e-6)
    try:
        edges = ConvexHull(support[:, :2]).equations
    except QhullError:
        return -1.0
    inside = float((-edges[:, :2] @ center[:2] - edges[:, 2]).min())
    return math.atan2(inside, height)
