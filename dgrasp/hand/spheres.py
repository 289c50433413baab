"""The hand's surface as spheres, placed for many hands at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.errors import DataError
from dgrasp.hand.model import HandModel
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape

CONTACT_DISTANCE = 0.015
"""m. A part this close to the object should touch it (section 3.1, docs/deviations.md)."""

_AXIS_SPACING = 0.004
_FACE_SPACING = 0.015


@dataclass(frozen=True)
class HandSpheres:
    """The hand's collision shapes as spheres: (P, 3) centres in their parts' frames, (P,) radii, (P,) parts.

    n_parts: the number of the hand's parts.
    """

    centers: Array
    radii: Array
    parts: Array
    n_parts: int

    @classmethod
    def of_hand(cls, hand: HandModel) -> HandSpheres:
        """The spheres of a hand. Capsules become spheres along their axes, boxes points on their faces (radius 0), and
        hulls their vertices (radius 0)."""
        centers: list[Array] = []
        radii: list[Array] = []
        parts: list[Array] = []
        for part in range(hand.layout.n_parts):
            for shape in hand.urdf.links[int(hand.part_links[part])].shapes:
                local, radius = _spheres(shape)
                R = matrix_from_quaternion(np.array(shape.quaternion))
                centers.append(local @ R.T + np.array(shape.position))
                radii.append(np.full(len(local), radius))
                parts.append(np.full(len(local), part))
        if not centers:
            raise DataError(f"hand {hand.id}: it has no collision shapes, so nothing can be measured on them; "
                            "expected a hand whose parts have some")
        return cls(np.concatenate(centers), np.concatenate(radii), np.concatenate(parts), hand.layout.n_parts)

    def take(self, rows: Array) -> HandSpheres:
        """The spheres that the mask `rows` selects."""
        return HandSpheres(self.centers[rows], self.radii[rows], self.parts[rows], self.n_parts)

    def place(self, R: Array, t: Array) -> Array:
        """(N, P, 3) centres, for the parts' frames as `Kinematics.part_frames` gives them."""
        out = np.empty((len(R), len(self.radii), 3))
        for part in range(self.n_parts):
            mine = self.parts == part
            out[:, mine] = np.matmul(self.centers[mine], np.swapaxes(R[:, part], 1, 2)) + t[:, part, None]
        return out

    def per_part(self, distances: Array) -> Array:
        """(N, number of parts) smallest distance from each part's surface, for distances (N, P) from the centres."""
        out = np.full((len(distances), self.n_parts), np.inf)
        for part in range(self.n_parts):
            mine = self.parts == part
            if mine.any():
                out[:, part] = (distances[:, mine] - self.radii[mine]).min(axis=1)
        return out


def _spheres(shape: Shape) -> tuple[Array, float]:
    """Centres in the shape's frame, and their radius."""
    if shape.kind == "capsule":
        radius, length = shape.size
        z = np.linspace(-length / 2, length / 2, max(2, int(np.ceil(length / _AXIS_SPACING)) + 1))
        return np.stack([0 * z, 0 * z, z], axis=1), radius
    if shape.kind == "hull":
        import trimesh  # Imported late: it takes a second.

        return np.array(trimesh.load_mesh(shape.file).vertices) * np.array(shape.scale), 0.0
    if shape.kind != "box":
        raise DataError(f"a hand with a {shape.kind} as collision shape; expected capsules, boxes and hulls")
    grids = [np.linspace(-s / 2, s / 2, max(2, int(np.ceil(s / _FACE_SPACING)) + 1)) for s in shape.size]
    grid = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 3)
    on_face = (np.abs(grid) >= np.array(shape.size) / 2 - 1e-12).any(axis=1)
    return grid[on_face], 0.0
