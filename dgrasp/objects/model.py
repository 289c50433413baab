"""What the physics needs to know of an object."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dgrasp.types import Array
from raisim_like.shapes import Shape


@dataclass(frozen=True)
class ObjectModel:
    """An object in its own frame O.

    shapes: collision shapes in O. mass: kg. center_of_mass_O: (3,) m. inertia: (3, 3) kg m^2 about the
    centre of mass, axes of O. mesh: a file of its closed surface in O, where there is one beside the shapes; it is
    measured on and drawn, not simulated.
    """

    name: str
    shapes: tuple[Shape, ...]
    mass: float
    center_of_mass_O: Array
    inertia: Array
    mesh: Path | None = None
