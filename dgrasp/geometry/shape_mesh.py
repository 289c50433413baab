"""Collision shapes as triangles."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np

from dgrasp.types import Array
from raisim_like.shapes import Shape
from raisim_like.urdf import shape_pose

SEGMENTS = 32
"""Corners of a circle. They lie a little outside it, so that round shapes keep their volume."""


def shape_mesh(shape: Shape, segments: int = SEGMENTS) -> tuple[Array, Array]:
    """Vertices (V, 3) m and faces (F, 3), wound outwards, in the frame of the shape's body.

    A hull is the convex hull of its file's vertices, a mesh its file's triangles. segments: corners of a circle.
    """
    import manifold3d

    solid = manifold3d.Manifold
    made: Any
    if shape.kind == "box":
        made = solid.cube(shape.size, True)
    elif shape.kind == "cylinder":
        radius, length = shape.size
        made = solid.cylinder(length, _circle(segments) * radius, circular_segments=segments, center=True)
    elif shape.kind in ("sphere", "capsule"):
        ball = solid.sphere(_ball(segments) * shape.size[0], segments)
        length = shape.size[1] if shape.kind == "capsule" else 0.0
        made = solid.batch_hull([ball.translate((0.0, 0.0, end * length / 2)) for end in (-1.0, 1.0)])
    else:
        if shape.file is None:
            raise ValueError(f"a shape of kind {shape.kind!r} needs a file")
        from dgrasp.geometry.inertia import load_mesh

        mesh = load_mesh(shape.file, shape.scale)
        mesh = mesh.convex_hull if shape.kind == "hull" else mesh
        return _placed(shape, np.asarray(mesh.vertices), np.asarray(mesh.faces))
    triangles = made.to_mesh64()
    return _placed(shape, np.asarray(triangles.vert_properties)[:, :3], np.asarray(triangles.tri_verts))


def shapes_vertices(shapes: Iterable[Shape]) -> Array:
    """(V, 3) m: the vertices of all shapes of a body, in its frame."""
    return np.concatenate([shape_mesh(shape)[0] for shape in shapes])


def _circle(segments: int) -> float:
    """Radius of a polygon's corners over that of the circle of the same area."""
    return float(np.sqrt((2.0 * np.pi / segments) / np.sin(2.0 * np.pi / segments)))


@cache
def _ball(segments: int) -> float:
    """Radius of the corners of `Manifold.sphere` over that of the ball of the same volume."""
    import manifold3d

    return float((4.0 / 3.0 * np.pi / manifold3d.Manifold.sphere(1.0, segments).volume()) ** (1.0 / 3.0))


def _placed(shape: Shape, vertices: Array, faces: Array) -> tuple[Array, Array]:
    T = shape_pose(shape)
    return vertices @ T[:3, :3].T + T[:3, 3], faces.astype(np.int64)
