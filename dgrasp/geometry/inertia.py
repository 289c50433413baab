"""Mass properties of collision shapes: volume, centre of mass and inertia, by closed forms and volume integrals.

Everything is computed at density 1 kg/m^3 and scaled to a mass afterwards, because objects have a known
mass and no known density. In a compound each shape counts in full: where two shapes overlap, the overlap counts twice.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.obj_file import read_obj
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class MassProperties:
    """Mass properties of a homogeneous body at density 1 kg/m^3, in the frame that the function names.

    volume: m^3, which at this density is also the mass in kg. center_of_mass: (3,) m.
    inertia: (3, 3) kg m^2 about the centre of mass, axes of the frame.
    """

    volume: float
    center_of_mass: Array
    inertia: Array

    def inertia_of(self, mass: float) -> Array:
        """(3, 3) inertia in kg m^2 about the centre of mass when the whole body weighs `mass` kg."""
        return self.inertia * (mass / self.volume)

    def moved(self, position: Array, rotation: Array) -> MassProperties:
        """The same body after x -> rotation @ x + position; position (3,) m, rotation (3, 3)."""
        return MassProperties(
            self.volume, rotation @ self.center_of_mass + position, rotation @ self.inertia @ rotation.T
        )


def box_properties(x: float, y: float, z: float) -> MassProperties:
    """A box with full edge lengths x, y, z in m, centred at the origin."""
    volume = x * y * z
    moments = volume / 12.0 * np.array([y * y + z * z, z * z + x * x, x * x + y * y])
    return MassProperties(volume, np.zeros(3), np.diag(moments))


def cylinder_properties(radius: float, length: float) -> MassProperties:
    """A cylinder along z, centred at the origin; m."""
    volume = math.pi * radius**2 * length
    across = volume * (3.0 * radius**2 + length**2) / 12.0
    return MassProperties(volume, np.zeros(3), np.diag([across, across, volume * radius**2 / 2.0]))


def sphere_properties(radius: float) -> MassProperties:
    """A ball centred at the origin; m."""
    volume = 4.0 / 3.0 * math.pi * radius**3
    return MassProperties(volume, np.zeros(3), 0.4 * volume * radius**2 * np.eye(3))


def capsule_properties(radius: float, length: float) -> MassProperties:
    """A capsule along z, centred at the origin; `length` in m is that of the straight part, without the caps."""
    barrel, ball = cylinder_properties(radius, length), sphere_properties(radius)
    # Two half balls: each has its centre of mass 3r/8 beyond the end of the barrel, hence the mixed term.
    shift = ball.volume * (length**2 / 4.0 + 3.0 / 8.0 * length * radius)
    caps = ball.inertia + np.diag([shift, shift, 0.0])
    return MassProperties(barrel.volume + ball.volume, np.zeros(3), barrel.inertia + caps)


def combine(parts: Iterable[MassProperties]) -> MassProperties:
    """A compound of bodies given in one common frame, by the parallel-axis theorem; overlaps count twice.

    Raises `ValueError` if there are no parts.
    """
    parts = list(parts)
    if not parts:
        raise ValueError("a compound needs at least one part")
    volume = sum(part.volume for part in parts)
    center = sum((part.volume * part.center_of_mass for part in parts), start=np.zeros(3)) / volume
    inertia = np.zeros((3, 3))
    for part in parts:
        d = part.center_of_mass - center
        inertia += part.inertia + part.volume * (d @ d * np.eye(3) - np.outer(d, d))
    return MassProperties(volume, center, inertia)


LEAST_SHARE = 0.01
"""Share of a homogeneous body's moment. A body with less would have nearly all its mass at its centre."""


def moment_bounds(axes: Array, mass: float, solid: Array, bounds: Array, center: Array) -> tuple[Array, Array]:
    """(n,) least and greatest moments of inertia, kg m^2, that a body can have about axes through its centre of mass.

    axes: (n, 3) unit vectors. solid: (3, 3) kg m^2, of the homogeneous body of this mass (kg). bounds: (2, 3) m, the
    corners of a box around the body. center: (3,) m. At most, all mass is at the corner that is farthest from the axis.
    """
    corners = np.array(list(itertools.product(*bounds.T))) - center
    squared = (corners**2).sum(axis=1)[:, None] - (corners @ axes.T) ** 2
    return LEAST_SHARE * np.einsum("ij,jk,ik->i", axes, solid, axes), mass * squared.max(axis=0)


def load_mesh(path: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> trimesh.Trimesh:
    """The triangles of a mesh file in m, its vertices merged, times `scale` along its axes.

    A `DataError` names a missing or damaged file.
    """
    import trimesh  # Late: it takes a second, which a worker with free objects need not spend.

    path = Path(path)
    if not path.is_file():
        raise DataError(
            f"{path}: this mesh does not exist; expected the authors' release with objects/<name>/{path.name} "
            "(or use the free objects)"
        )
    try:
        if path.suffix.lower() == ".obj":  # trimesh misreads negative indices.
            vertices, faces = read_obj(path.read_bytes())
            mesh: Any = trimesh.Trimesh(vertices, faces) if len(faces) and np.isfinite(vertices).all() else None
        else:
            mesh = trimesh.load(path, force="mesh", skip_materials=True)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    except (ArithmeticError, AttributeError, LookupError, OSError, TypeError, ValueError) as error:
        # trimesh's parsers fail on a damaged file in many ways; to the user they are all the same.
        raise DataError(f"{path}: cannot be read as a mesh ({type(error).__name__}: {error})") from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        raise DataError(f"{path}: expected a mesh with faces and finite vertices, found none")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if scale != (1.0, 1.0, 1.0):
        mesh.apply_scale(scale)
    return mesh


def check_size(path: Path, extents: Array, expected: Sequence[float]) -> None:
    """Raise a `DataError` if a mesh is over ten times too large or small, for example because it is in centimetres.

    extents: the mesh's sides (3,) m. expected: the object's known sides (3,) m.
    """
    ratio = float(np.max(extents)) / max(expected)
    if not 0.1 <= ratio <= 10.0:
        raise DataError(f"{path}: its longest side is {np.max(extents):.3g} m, the object's {max(expected):.3g} m; "
                        "expected metres. Convert the mesh, or name a folder that has it in metres")


def mesh_properties(
    path: Path, convex: bool = False, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> MassProperties:
    """Of a mesh file times `scale`, in the mesh's frame.

    A closed and consistently wound surface is integrated as it is. An open or inconsistent one encloses no volume and
    is replaced by its convex hull, and so is every mesh if `convex`. Raises `DataError` for a flat mesh.
    """
    mesh = load_mesh(path, scale)
    spread = np.linalg.svd(mesh.vertices - mesh.vertices.mean(axis=0), compute_uv=False)
    if len(spread) < 3 or spread[2] < 1e-9 * spread[0]:
        raise DataError(f"{path}: the mesh is flat; expected one that encloses a volume")
    if convex or not mesh.is_volume:
        mesh = mesh.convex_hull
    return MassProperties(float(mesh.volume), np.array(mesh.center_mass), np.array(mesh.moment_inertia))


def shape_properties(shape: Shape) -> MassProperties:
    """Mass properties of one collision shape, in its body's frame. Raises `DataError` for an unreadable mesh file."""
    if shape.kind in ("mesh", "hull"):
        if shape.file is None:
            raise ValueError(f"a shape of kind {shape.kind!r} needs a file")
        local = mesh_properties(shape.file, shape.kind == "hull", shape.scale)
    elif shape.kind == "box":
        local = box_properties(*shape.size)
    elif shape.kind == "cylinder":
        local = cylinder_properties(*shape.size)
    elif shape.kind == "capsule":
        local = capsule_properties(*shape.size)
    else:
        local = sphere_properties(*shape.size)
    return local.moved(np.array(shape.position), matrix_from_quaternion(np.array(shape.quaternion)))
