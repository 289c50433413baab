"""How far collision shapes are from the solid that they stand for: distances between the two surfaces, both ways."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dgrasp.geometry.intersection import body
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.geometry.surface_distance import SampledSurface, surface_samples
from dgrasp.objects.add.repair import RepairedSolid
from dgrasp.types import Array
from raisim_like.shapes import Shape

CLOSE = 0.002
"""m. Surfaces that are farther apart than this get a remark."""
_SAMPLES = 20_000
"""Points of a surface, about."""
_SPECK = 0.001
"""Share of a surface that is ignored: scans leave fragments inside of an object, which nothing touches."""
_PLACES, _APART = 3, 0.03
"""Most places that a remark names, and the least distance between them (m)."""


@dataclass(frozen=True, eq=False)
class Gaps:
    """Distances between the surfaces of a solid and of shapes, in the solid's frame, m.

    missed (N, 3), missed_by (N,): points of the solid's surface, and their distances from that of the shapes' union.
    added (M, 3), added_by (M,): points of the shapes' surface, and their distances from the solid's.
    """

    missed: Array
    missed_by: Array
    added: Array
    added_by: Array

    @property
    def largest(self) -> float:
        """The largest distance, m, without specks of a surface."""
        return max(_farthest(self.missed_by), _farthest(self.added_by))

    @property
    def share_close(self) -> float:
        """Share of the points within `CLOSE` of the other surface; of the two surfaces the one with the lower share."""
        return float(min((self.missed_by <= CLOSE).mean(), (self.added_by <= CLOSE).mean()))

    def remarks(self) -> list[str]:
        """Where the surfaces are more than `CLOSE` apart, and by how much."""
        said = []
        for what, points, far in (("of the surface are not met", self.missed, self.missed_by),
                                  ("of the collision shapes stand off", self.added, self.added_by)):
            share = (far > CLOSE).mean()
            if _farthest(far) > CLOSE:
                places = _places(points, far)
                text = ", ".join(f"{1000 * by:.1f} mm at ({x:.0f}, {y:.0f}, {z:.0f})" for (x, y, z), by in places)
                said.append(f"{share:.1%} {what} by over {1000 * CLOSE:g} mm: {text}")
        return said


def judge(solid: RepairedSolid, shapes: Sequence[Shape]) -> Gaps:
    """The gaps between a solid and shapes in its frame."""
    own = solid.mesh
    theirs = body([shape_mesh(shape) for shape in shapes]).surface()
    spacing = [_spacing(*own), _spacing(*theirs)]
    missed, added = surface_samples(*own, spacing[0])[0], surface_samples(*theirs, spacing[1])[0]
    return Gaps(missed, SampledSurface(*theirs, spacing[1]).distances(missed), added,
                SampledSurface(*own, spacing[0]).distances(added))


def _spacing(vertices: Array, faces: Array) -> float:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    return float((area / _SAMPLES) ** 0.5)


def _farthest(far: Array) -> float:
    return float(np.quantile(far, 1.0 - _SPECK))


def _places(points: Array, far: Array) -> list[tuple[Array, float]]:
    """The worst places (mm) and their distances (m), each apart from the others."""
    places: list[tuple[Array, float]] = []
    left = far > CLOSE
    while left.any() and len(places) < _PLACES:
        worst = int(np.where(left, far, 0.0).argmax())
        places.append((1000 * points[worst], float(far[worst])))
        left &= np.linalg.norm(points - points[worst], axis=1) > _APART
    return places
