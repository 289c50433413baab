"""An object's surface as a body, for measurements on meshes; it is not simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgrasp.geometry.inertia import check_size
from dgrasp.geometry.intersection import Body, body
from dgrasp.geometry.shape_mesh import shape_mesh, shapes_vertices
from dgrasp.objects.model import ObjectModel
from dgrasp.types import Array
from raisim_like.shapes import Shape

DETAILED_MESH = "textured_meshlab.obj"
"""The most detailed mesh of an object in the authors' release."""


@dataclass(frozen=True, eq=False)
class ObjectBody:
    """An object in its frame O.

    detailed: made from the release's detailed mesh. own: made from the project's or the user's mesh. With neither, it
    is made from the collision shapes.
    """

    body: Body
    detailed: bool
    own: bool = False


def object_body(model: ObjectModel, objects_dir: Path) -> ObjectBody:
    """The object's detailed mesh if `objects_dir` has one, else its model's mesh, else its collision shapes.

    Raises `DataError` for a mesh that is damaged or in another unit.
    """
    file = Path(objects_dir) / model.name / DETAILED_MESH
    detailed = file.is_file()
    mesh = file if detailed else model.mesh
    shapes: Sequence[Shape] = model.shapes if mesh is None else (Shape("mesh", file=mesh),)
    parts = [shape_mesh(shape) for shape in shapes]
    if detailed:
        check_size(file, np.ptp(parts[0][0], axis=0), np.ptp(shapes_vertices(model.shapes), axis=0))
    return ObjectBody(body(parts), detailed, not detailed and mesh is not None)


def surface_points(of: Body, spacing: float) -> Array:
    """(P, 3) m: points all over the body's surface, neighbours at most `spacing` (m) apart."""
    import trimesh  # Imported late: it takes a second.

    vertices, _ = trimesh.remesh.subdivide_to_size(*of.surface(), max_edge=spacing, max_iter=20)
    return np.unique(np.asarray(vertices), axis=0)
