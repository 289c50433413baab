"""Signed distances between the hand's parts and an object of primitives: what labels are checked against."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgrasp.hand.model import HandModel
from dgrasp.hand.spheres import HandSpheres
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape


def signed_distance(shapes: Sequence[Shape], points_O: Array) -> Array:
    """(...) m: distance of points (..., 3) to the union of primitives, negative inside.

    Exact outside; inside the union it is the depth in the deepest primitive.
    """
    # One row per coordinate: numpy reduces short last axes slowly.
    rows = points_O.reshape(-1, 3).T
    best = np.full(rows.shape[1], np.inf)
    for shape in shapes:
        R = matrix_from_quaternion(np.array(shape.quaternion))
        x, y, z = np.abs(R.T @ rows - (R.T @ np.array(shape.position))[:, None])
        if shape.kind == "box":
            a, b, c = shape.size
            distance = _beyond(x - a / 2, y - b / 2, z - c / 2)
        elif shape.kind == "cylinder":
            radius, length = shape.size
            distance = _beyond(np.sqrt(x * x + y * y) - radius, z - length / 2)
        elif shape.kind == "capsule":
            radius, length = shape.size
            z = np.maximum(z - length / 2, 0.0)
            distance = np.sqrt(x * x + y * y + z * z) - radius
        elif shape.kind == "sphere":
            distance = np.sqrt(x * x + y * y + z * z) - shape.size[0]
        else:
            raise ValueError(f"the distance to a {shape.kind} needs its file; expected a primitive")
        np.minimum(best, distance, out=best)
    return best.reshape(points_O.shape[:-1])


def _beyond(*excess: Array) -> Array:
    """Distance to a product of intervals, from how far each coordinate lies beyond its interval."""
    squares = np.zeros_like(excess[0])
    deepest = excess[0]
    for coordinate in excess:
        squares += np.maximum(coordinate, 0.0) ** 2
        deepest = np.maximum(deepest, coordinate)
    distance: Array = np.sqrt(squares) + np.minimum(deepest, 0.0)
    return distance


def part_distances(
    hand: HandModel, spheres: HandSpheres, shapes: Sequence[Shape], T_WH: Array, hand_pose: Array, T_WO: Array
) -> Array:
    """(N, 16) m between the hand's parts and the object at T_WO (N, 4, 4), negative where they overlap."""
    centers_W = spheres.place(*hand.part_poses(T_WH, hand_pose))
    centers_O = np.matmul(centers_W - T_WO[:, None, :3, 3], T_WO[:, :3, :3])
    return spheres.per_part(signed_distance(shapes, centers_O))


def hand_bottom(hand: HandModel, spheres: HandSpheres, T_WH: Array, hand_pose: Array) -> Array:
    """(N,) m: height of the hand's lowest point in the world."""
    centers_W = spheres.place(*hand.part_poses(T_WH, hand_pose))
    bottom: Array = (centers_W[..., 2] - spheres.radii).min(axis=1)
    return bottom
