"""The volume that two bodies share: by booleans of their meshes, cross-checked by counting points.

A body is the union of closed meshes that may overlap, such as the parts of a hand. Each mesh is closed first. Then the
meshes are united, so that no volume counts twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dgrasp.geometry.closing import close_mesh
from dgrasp.geometry.winding import winding_grid
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_euler

PITCH = 0.002
"""Spacing of the cross-check's points, m."""
TOLERANCE = 0.05
"""Largest difference between the two methods that is not reported, as a share of the larger volume."""
FLOOR = 1e-7
"""m^3 (0.1 cm^3). Differences up to this size are not reported; twelve points more or less amount to it."""


@dataclass(frozen=True, eq=False)
class Body:
    """A union of closed meshes, m.

    vertices (V, 3), faces (F, 3): all meshes together, wound outwards. solid: the union for booleans; None if a
    mesh is not a solid even after capping. holes: the number of capped holes.
    """

    vertices: Array
    faces: Array
    solid: Any
    holes: int

    def placed(self, T: Array) -> Body:
        """The body moved by T (4, 4)."""
        solid = None if self.solid is None else self.solid.transform(np.ascontiguousarray(T[:3]))
        return Body(self.vertices @ T[:3, :3].T + T[:3, 3], self.faces, solid, self.holes)

    @property
    def bounds(self) -> Array:
        """(2, 3) lowest and highest corner of the box around it."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def surface(self) -> tuple[Array, Array]:
        """Vertices (V, 3) m and faces (F, 3) of the union's surface, or of all meshes if there is no solid."""
        if self.solid is None:
            return self.vertices, self.faces
        mesh = self.solid.to_mesh64()
        return np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, dtype=np.int64)


@dataclass(frozen=True)
class Overlap:
    """What two bodies share, m^3.

    volume: by booleans, or by points if a body is not a solid (then `exact` is False). by_points: the cross-check.
    """

    volume: float
    by_points: float
    exact: bool

    @property
    def disagrees(self) -> bool:
        """Whether the two methods differ by more than `TOLERANCE` and by more than `FLOOR`."""
        difference = abs(self.volume - self.by_points)
        return difference > max(FLOOR, TOLERANCE * max(self.volume, self.by_points))


def body(meshes: Sequence[tuple[Array, Array]]) -> Body:
    """The union of meshes (vertices (V, 3) m, faces (F, 3)); holes are capped (see `close_mesh`)."""
    return join([_shell(vertices, faces) for vertices, faces in meshes])


def join(bodies: Sequence[Body]) -> Body:
    """The union of bodies, at least one."""
    import manifold3d

    if len(bodies) == 1:
        return bodies[0]
    starts = np.cumsum([0, *(len(b.vertices) for b in bodies[:-1])])
    faces = np.concatenate([b.faces + start for b, start in zip(bodies, starts, strict=True)])
    solids = [b.solid for b in bodies]
    united = None
    if all(solid is not None for solid in solids):
        united = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    return Body(np.concatenate([b.vertices for b in bodies]), faces, united, sum(b.holes for b in bodies))


def near(bodies: Sequence[Body], other: Body) -> list[Body]:
    """The bodies whose boxes meet that of `other`; the rest share no volume with it."""
    low, high = other.bounds
    return [b for b in bodies if (b.bounds[0] < high).all() and (b.bounds[1] > low).all()]


def overlap(a: Body, b: Body, pitch: float = PITCH) -> Overlap:
    """The volume inside both bodies; pitch: spacing (m) of the cross-check's points."""
    if not near([a], b):
        return Overlap(0.0, 0.0, True)
    by_points = _count(a, b, pitch)
    if a.solid is None or b.solid is None:
        return Overlap(by_points, by_points, False)
    return Overlap(float((a.solid ^ b.solid).volume()), by_points, True)


def _count(a: Body, b: Body, pitch: float) -> float:
    """The shared volume (m^3) by the points of a grid that are inside both bodies."""
    turned = [one.vertices @ _TILT.T for one in (a, b)]
    low = np.max([v.min(axis=0) for v in turned], axis=0)
    high = np.min([v.max(axis=0) for v in turned], axis=0)
    counts = np.ceil((high - low) / pitch).astype(int)
    if not (counts > 0).all():
        return 0.0
    start = (low + high - pitch * (counts - 1)) / 2.0
    size = (int(counts[0]), int(counts[1]), int(counts[2]))
    inside = [winding_grid(v, one.faces, start, pitch, size) > 0 for v, one in zip(turned, (a, b), strict=True)]
    return float((inside[0] & inside[1]).sum() * pitch**3)


_TILT = matrix_from_euler(np.array([0.61, 0.43, 0.29]))
"""Turns the bodies against the grid, so that no flat face of an object lies along its layers."""


def _shell(vertices: Array, faces: Array) -> Body:
    import manifold3d

    closed = close_mesh(vertices, faces)
    mesh = manifold3d.Mesh64(np.ascontiguousarray(closed.vertices), np.ascontiguousarray(closed.faces, dtype=np.uint64))
    solid = manifold3d.Manifold(mesh)
    fine = solid.status() == manifold3d.Error.NoError and not solid.is_empty()
    return Body(closed.vertices, closed.faces, solid if fine else None, closed.holes)
