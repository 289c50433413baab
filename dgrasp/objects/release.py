"""The objects of the authors' release: a folder `objects/<name>/` of meshes per object."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.inertia import check_size, load_mesh
from dgrasp.objects.add.parts import convex_parts
from dgrasp.objects.catalogue import MassSet, catalogue_object
from dgrasp.objects.model import ObjectModel, object_model

Concave = Literal["auto", "mesh", "parts"]


def release_object(
    objects_dir: Path, name: str, masses: MassSet, official_compat: bool, concave: Concave = "auto"
) -> ObjectModel:
    """The object `name` with the authors' choice of collision shape, in its mesh's frame O.

    objects_dir: the release's `objects` folder; it is read for objects that collide as a mesh, not for boxes and
    cylinders. masses: "official" as the authors simulate them, "ycb" as published.
    official_compat: centre of mass at the origin and 1 kg m^2 about every axis instead of the shape's own.
    concave: "mesh" keeps the authors' concave meshes, "parts" cuts them into convex parts, and "auto" takes whichever
    of the two grasps more like the authors' simulation. Centre of mass and inertia are the mesh's either way.
    Raises `DataError` for an unknown name or a mesh that is missing, damaged or in another unit.
    """
    entry = catalogue_object(name)
    shape = entry.collision
    if shape.file is not None:
        file = Path(objects_dir) / entry.name / shape.file
        if not file.is_file():
            raise DataError(
                f"{file}: the collision mesh of {entry.name} is missing; expected the release's objects folder with "
                f"{entry.name}/{file.name}. Point --data at a folder that has it, or use --data free"
            )
        check_size(file, np.ptp(load_mesh(file).vertices, axis=0), entry.extents)
        shape = replace(shape, file=file)
    model = object_model(entry.name, (shape,), entry.mass(masses), official_compat)
    cut = concave == "parts" or (concave == "auto" and not entry.thin)
    if shape.kind == "mesh" and shape.file is not None and cut:
        return replace(model, shapes=convex_parts(shape.file))
    return model
