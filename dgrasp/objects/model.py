"""What the physics needs to know about an object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgrasp.geometry.inertia import combine, shape_properties
from dgrasp.types import Array
from raisim_like.shapes import Shape


@dataclass(frozen=True)
class ObjectModel:
    """An object in its own frame O.

    shapes: collision shapes in O. mass: kg. center_of_mass_O: (3,) m. inertia: (3, 3) kg m^2 about the
    centre of mass, axes of O. mesh: a file of its closed surface in O, if there is one besides the shapes; it is
    used for measurements and pictures, not simulated.
    """

    name: str
    shapes: tuple[Shape, ...]
    mass: float
    center_of_mass_O: Array
    inertia: Array
    mesh: Path | None = None


def object_model(name: str, shapes: Sequence[Shape], mass: float, official_compat: bool) -> ObjectModel:
    """An object of `mass` kg made of `shapes` in its frame O.

    official_compat: as the authors' simulation has it, with the centre of mass at the origin of O and an inertia
    of 1 kg m^2 about every axis, so that objects hardly rotate; otherwise both follow from the shapes.
    """
    if official_compat:
        return ObjectModel(name, tuple(shapes), mass, np.zeros(3), np.eye(3))
    whole = combine(shape_properties(shape) for shape in shapes)
    return ObjectModel(name, tuple(shapes), mass, whole.center_of_mass, whole.inertia_of(mass))
