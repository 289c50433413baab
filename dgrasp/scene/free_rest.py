"""Poses in which the free objects rest on the table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dgrasp.objects.free import shape_bounds
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion, quaternion_from_matrix, transform
from raisim_like.shapes import Shape

PLACE_XY = ((0.42, 0.10), (0.62, 0.35))
"""m: corners of the rectangle in which the objects rest, world."""

Angles = tuple[float, float, float]
_AS_MODELLED, _ON_Y, _ON_X = (0.0, 0.0, 0.0), (math.pi / 2, 0.0, 0.0), (0.0, math.pi / 2, 0.0)
_REST: dict[str, tuple[Angles, ...]] = {
    "003_cracker_box": (_AS_MODELLED, _AS_MODELLED, _ON_X),
    "004_sugar_box": (_AS_MODELLED, _AS_MODELLED, _ON_X),
    "006_mustard_bottle": (_AS_MODELLED, _AS_MODELLED, _ON_Y),
    "008_pudding_box": (_AS_MODELLED, _AS_MODELLED, _ON_Y),
    "009_gelatin_box": (_AS_MODELLED, _AS_MODELLED, _ON_Y),
    "010_potted_meat_can": (_AS_MODELLED, _AS_MODELLED, _ON_X),
    "021_bleach_cleanser": (_AS_MODELLED, _AS_MODELLED, _ON_Y),
    "036_wood_block": (_AS_MODELLED, _AS_MODELLED, _ON_Y),
    "040_large_marker": (_ON_Y,),
    "061_foam_brick": (_AS_MODELLED, _ON_Y, _ON_X),
}
"""Orientations at rest as intrinsic XYZ Euler angles, rad; frequent ones are listed twice. Other objects rest as
modelled, without a turn."""


def place_at_rest(model: ObjectModel, rng: np.random.Generator, n: int) -> Array:
    """(n, 4, 4) T_WO of the object at rest on the table, each at a random place and yaw."""
    from scipy.spatial.transform import Rotation

    downs = [Rotation.from_euler("XYZ", angles).as_matrix() for angles in _REST.get(model.name, (_AS_MODELLED,))]
    heights = np.array([TABLE_TOP - lowest(model.shapes, R) for R in downs])
    chosen = rng.integers(len(downs), size=n)
    yaw = Rotation.from_rotvec(rng.uniform(-math.pi, math.pi, n)[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    position = np.concatenate([rng.uniform(*PLACE_XY, (n, 2)), heights[chosen, None]], axis=1)
    return transform(yaw @ np.array(downs)[chosen], position)


def lowest(shapes: Sequence[Shape], R_WO: Array) -> float:
    """m: height of the lowest point of primitives turned by R_WO, above their frame's origin (negative if below)."""
    turned = []
    for shape in shapes:
        q = quaternion_from_matrix(R_WO @ matrix_from_quaternion(np.array(shape.quaternion)))
        x, y, z = (float(v) for v in R_WO @ np.array(shape.position))
        a, b, c, d = (float(v) for v in q)
        turned.append(replace(shape, position=(x, y, z), quaternion=(a, b, c, d)))
    return float(shape_bounds(turned)[0, 2])
