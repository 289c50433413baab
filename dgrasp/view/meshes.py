"""What viewers draw: light meshes of the hand's parts and of the object, their collision shapes, and their poses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dgrasp.geometry.intersection import Body, body, join
from dgrasp.geometry.shape_mesh import SEGMENTS, shape_mesh
from dgrasp.hand.kinematics import Kinematics
from dgrasp.hand.layout import N_WRIST
from dgrasp.hand.model import HandModel
from dgrasp.hand.surface import rigid_surface
from dgrasp.objects.model import ObjectModel
from dgrasp.types import Array, EpisodeRecord
from raisim_like.rotations import quaternion_from_matrix
from raisim_like.shapes import Shape

PART_FACES, OBJECT_FACES = 320, 2500
"""Most triangles of a hand part and of an object."""
BALL_SEGMENTS = SEGMENTS // 2
"""Corners of a ball's equator. A capsule then has 160 triangles, all within 3% of its radius from its surface."""


class Mesh(NamedTuple):
    """vertices (V, 3) m in the body's frame, faces (F, 3) wound outwards."""

    vertices: Array
    faces: Array


@dataclass(frozen=True, eq=False)
class DisplayMeshes:
    """A hand and an object to draw.

    chain: the hand's kinematics. parts: names of its parts. hand: the parts' meshes in their own frames; the mesh of a
    part without a shape has no faces. object: the object's mesh, in O. shapes: what the engine collides for each of
    `bodies`, in its frame; empty if it is not known.
    """

    chain: Kinematics
    parts: tuple[str, ...]
    hand: tuple[Mesh, ...]
    object: Mesh
    shapes: tuple[Mesh, ...] = ()

    @property
    def bodies(self) -> tuple[str, ...]:
        """The rigid bodies of a replay: the hand's parts, then the object."""
        return (*self.parts, "object")

    def colliding(self) -> DisplayMeshes:
        """The same with the collision shapes in place of the surfaces; `shapes` must not be empty."""
        return replace(self, hand=self.shapes[:-1], object=self.shapes[-1])


def scene_meshes(hand: HandModel, model: ObjectModel) -> DisplayMeshes:
    """Light meshes of a hand and an object: of its surface where a file of it is at hand, else of its shapes."""
    shapes = model.shapes if model.mesh is None else (Shape("mesh", file=model.mesh),)
    surface = light(body([shape_mesh(shape) for shape in shapes]), OBJECT_FACES)
    collision = (*hand_shapes(hand), object_shapes(model))
    return DisplayMeshes(hand.chain, hand.layout.names.parts, hand_meshes(hand), surface, collision)


def hand_meshes(hand: HandModel) -> tuple[Mesh, ...]:
    """The parts' meshes, each of at most `PART_FACES` triangles."""
    surface = rigid_surface(hand)
    parts = [surface.local(part) for part in range(hand.layout.n_parts)]
    return tuple(light(join(bodies), PART_FACES) if bodies else _joined([]) for bodies in parts)


def hand_shapes(hand: HandModel) -> tuple[Mesh, ...]:
    """The collision shapes of the hand's parts, each of at most `PART_FACES` triangles."""
    return tuple(_drawn(hand.urdf.links[int(link)].shapes, PART_FACES) for link in hand.part_links)


def object_shapes(model: ObjectModel) -> Mesh:
    """The collision shapes of an object, each of at most `OBJECT_FACES` triangles."""
    return _drawn(model.shapes, OBJECT_FACES)


def _drawn(shapes: Iterable[Shape], limit: int) -> Mesh:
    """Shapes side by side in one mesh; unlike a union, it shows where one shape ends in another."""
    meshes = []
    for shape in shapes:
        vertices, faces = shape_mesh(shape, BALL_SEGMENTS if shape.kind in ("sphere", "capsule") else SEGMENTS)
        meshes.append(light(body([(vertices, faces)]), limit) if len(faces) > limit else Mesh(vertices, faces))
    return _joined(meshes)


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several, which share no vertices; without any, it has no faces."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(np.concatenate([np.zeros((0, 3)), *(mesh.vertices for mesh in meshes)]),
                np.concatenate([np.zeros((0, 3), dtype=np.int64),
                                *(mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True))]))


def light(solid: Body, limit: int) -> Mesh:
    """The surface of a body with at most about `limit` triangles.

    A solid is simplified with the smallest tolerance of 0.1 mm times a power of 2 that suffices. If that fails, or if
    the body is not a solid, the vertices in each cell of a grid of cubes are merged.
    """
    mesh = Mesh(*solid.surface())
    size = float(np.ptp(mesh.vertices, axis=0).max())
    tolerance = 1e-4
    while solid.solid is not None and len(mesh.faces) > limit and tolerance < 0.05 * size:
        triangles = solid.solid.simplify(tolerance).to_mesh64()
        if len(triangles.tri_verts):
            mesh = Mesh(np.asarray(triangles.vert_properties)[:, :3], np.asarray(triangles.tri_verts, dtype=np.int64))
        tolerance *= 2.0
    cell = size / 128.0
    full = mesh
    while len(mesh.faces) > limit:
        mesh = merged(full, cell)
        cell *= 1.25
    return mesh


def merged(mesh: Mesh, cell: float) -> Mesh:
    """The mesh with all vertices in each cube of side `cell` (m) merged at their mean."""
    cubes = np.floor(mesh.vertices / cell).astype(np.int64)
    _, owner = np.unique(cubes, axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    count = np.bincount(owner)
    vertices = np.stack([np.bincount(owner, weights=mesh.vertices[:, k]) / count for k in range(3)], axis=1)
    faces = owner[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(vertices[used], faces.reshape(-1, 3))


def body_poses(meshes: DisplayMeshes, record: EpisodeRecord) -> tuple[Array, Array]:
    """Quaternions (T, B, 4), w, x, y, z, and positions (T, B, 3) m of `meshes.bodies` in the world at each step.

    Quaternions are `blendable`. Steps with NaN or infinity, left by a broken simulation, repeat the last finite step.
    """
    n = len(record.gc)
    rows = np.concatenate([record.T_WH.reshape(n, -1), record.T_WO.reshape(n, -1), record.gc], axis=1)
    whole = np.maximum.accumulate(np.where(np.isfinite(rows).all(axis=1), np.arange(n), 0))
    T_WH, T_WO, gc = (np.nan_to_num(values[whole]) for values in (record.T_WH, record.T_WO, record.gc))
    R, t = meshes.chain.part_frames(T_WH[:, :3, :3], T_WH[:, :3, 3], gc[:, N_WRIST:])
    R = np.concatenate([R, T_WO[:, None, :3, :3]], axis=1)
    t = np.concatenate([t, T_WO[:, None, :3, 3]], axis=1)
    return blendable(R), t


def blendable(R: Array) -> Array:
    """Quaternions (T, ..., 4), w, x, y, z, of rotations (T, ..., 3, 3), with signs for interpolation over time.

    Each quaternion has a non-negative scalar product with its predecessor.
    """
    q = quaternion_from_matrix(R)
    q[1:] *= np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0), axis=0)
    return q


def table_tops(record: EpisodeRecord, on: float, lowered: float) -> Array:
    """(T,) m: height of the table's top during each step."""
    return np.where(record.table_stays | (np.arange(len(record.gc)) < record.window_start), on, lowered)
