"""The free objects: the 20 objects of the catalogue as the project's own primitives and compounds.

They have the YCB objects' published sizes and masses, and shapes designed here. The origin of the object frame O
is the centre of the bounding box; upright objects stand along z, long flat ones lie in the xy plane. Hollow
objects are rings of boxes, so that fingers reach inside. Surfaces are measured and drawn on the meshes of
`dgrasp.objects.free_mesh`, which ship as files.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dgrasp.files.paths import data_root
from dgrasp.objects.catalogue import CATALOGUE, MassSet, catalogue_object
from dgrasp.objects.model import ObjectModel, object_model
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion, quaternion_from_matrix
from raisim_like.shapes import Shape

Point = tuple[float, float, float]


def free_object(name: str, masses: MassSet, official_compat: bool) -> ObjectModel:
    """The free object `name`, such as "025_mug", in its frame O.

    masses: "official" as the authors simulate them, "ycb" as published. official_compat: centre of mass at the
    origin and 1 kg m^2 about every axis instead of the shape's own. Raises `DataError` for an unknown name.
    """
    entry = catalogue_object(name)
    model = object_model(entry.name, _SHAPES[entry.name], entry.mass(masses), official_compat)
    return replace(model, mesh=data_root() / "free" / "objects" / entry.name / "mesh.obj")


def shape_bounds(shapes: Sequence[Shape]) -> Array:
    """(2, 3) m: lowest and highest corner of the axis-aligned box around primitive shapes, in their body's frame."""
    corners = []
    for shape in shapes:
        R = np.abs(matrix_from_quaternion(np.array(shape.quaternion)))
        if shape.kind == "box":
            reach = R @ (np.array(shape.size) / 2)
        elif shape.kind == "cylinder":
            radius, length = shape.size
            reach = radius * np.sqrt(np.clip(1 - R[:, 2] ** 2, 0, None)) + R[:, 2] * length / 2
        elif shape.kind == "capsule":
            radius, length = shape.size
            reach = radius + R[:, 2] * length / 2
        elif shape.kind == "sphere":
            reach = np.full(3, shape.size[0])
        else:
            raise ValueError(f"bounds of a {shape.kind} shape need its file; expected a primitive")
        corners.append([np.array(shape.position) - reach, np.array(shape.position) + reach])
    low_high = np.array(corners)
    return np.stack([low_high[:, 0].min(axis=0), low_high[:, 1].max(axis=0)])


def _centred(shapes: Sequence[Shape]) -> tuple[Shape, ...]:
    """The shapes moved so that the centre of their bounding box is the origin."""
    middle = shape_bounds(shapes).mean(axis=0)
    moved = []
    for shape in shapes:
        x, y, z = (float(v) for v in np.array(shape.position) - middle)
        moved.append(replace(shape, position=(x, y, z)))
    return tuple(moved)


def _placed(kind: str, size: tuple[float, ...], position: Array, R: Array) -> Shape:
    x, y, z = (float(v) for v in position)
    a, b, c, d = (float(v) for v in quaternion_from_matrix(R))
    return Shape(kind, size, (x, y, z), (a, b, c, d))  # type: ignore[arg-type]


def _stack(*layers: tuple[float, float]) -> tuple[Shape, ...]:
    """Cylinders (radius, height) standing on each other from z = 0 upwards."""
    shapes, z = [], 0.0
    for radius, height in layers:
        shapes.append(Shape("cylinder", (radius, height), (0.0, 0.0, z + height / 2)))
        z += height
    return tuple(shapes)


def _raised(shapes: Sequence[Shape], dz: float) -> tuple[Shape, ...]:
    return tuple(replace(s, position=(s.position[0], s.position[1], s.position[2] + dz)) for s in shapes)


def _stadium(length: float, width: float, height: float, axis: str) -> tuple[Shape, ...]:
    """A block with two round ends, standing on z = 0: `length` along `axis` ("x" or "y"), `width` across."""
    straight, z = length - width, height / 2
    along = np.array([straight / 2, 0.0] if axis == "x" else [0.0, straight / 2])
    box = (straight, width, height) if axis == "x" else (width, straight, height)
    ends = tuple(
        Shape("cylinder", (width / 2, height), (float(sign * along[0]), float(sign * along[1]), z)) for sign in (-1, 1)
    )
    return (Shape("box", box, (0.0, 0.0, z)), *ends)


def _bar(start: Point, end: Point, width: float, thickness: float) -> Shape:
    """A box in the xy plane from `start` to `end`, `width` across and `thickness` along z."""
    a, b = np.array(start), np.array(end)
    angle = math.atan2(b[1] - a[1], b[0] - a[0])
    R = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    return _placed("box", (float(np.linalg.norm(b - a)), width, thickness), (a + b) / 2, R)


def _rod(start: Point, end: Point, radius: float, kind: str = "capsule") -> Shape:
    """A capsule or cylinder whose axis runs from `start` to `end`."""
    a, b = np.array(start), np.array(end)
    axis = (b - a) / np.linalg.norm(b - a)
    side = np.cross(np.eye(3)[int(np.argmin(np.abs(axis)))], axis)
    side /= np.linalg.norm(side)
    R = np.stack([side, np.cross(axis, side), axis], axis=1)
    return _placed(kind, (radius, float(np.linalg.norm(b - a))), (a + b) / 2, R)


def _path(points: Sequence[Point], radius: float, closed: bool = False) -> tuple[Shape, ...]:
    """Capsules from each point to the next."""
    ends = [*points[1:], points[0]] if closed else points[1:]
    return tuple(_rod(a, b, radius) for a, b in zip(points, ends, strict=False))


def _wall(count: int, low: tuple[float, float], high: tuple[float, float], thickness: float) -> tuple[Shape, ...]:
    """A round wall of `count` flat panels; `low` and `high` are (radius, z) of its middle surface at both rims."""
    (r0, z0), (r1, z1) = low, high
    slope = np.array([r1 - r0, z1 - z0])
    height = float(np.linalg.norm(slope))
    up_r, up_z = slope / height
    # As wide as the outer face needs at the wider rim; at the narrower rim, neighbours overlap.
    width = 2 * (max(r0, r1) + thickness / 2) * math.tan(math.pi / count)
    panels = []
    for i in range(count):
        c, s = math.cos(2 * math.pi * i / count), math.sin(2 * math.pi * i / count)
        outward = np.array([up_z * c, up_z * s, -up_r])
        upward = np.array([up_r * c, up_r * s, up_z])
        R = np.stack([outward, np.cross(upward, outward), upward], axis=1)
        middle = np.array([c * (r0 + r1) / 2, s * (r0 + r1) / 2, (z0 + z1) / 2])
        panels.append(_placed("box", (thickness, width, height), middle, R))
    return tuple(panels)


def _banana() -> tuple[Shape, ...]:
    """Five capsules on an arc, thickest in the middle, turned in the plane to match the two extents."""
    radius, half_angle, turn = 0.115, math.radians(48.7), math.radians(24.8)
    angles = np.linspace(-half_angle, half_angle, 6) + turn
    points = [(radius * math.cos(a), radius * math.sin(a), 0.0) for a in angles]
    thickness = (0.0105, 0.0165, 0.0185, 0.0165, 0.0105)
    return tuple(_rod(a, b, r) for a, b, r in zip(points[:-1], points[1:], thickness, strict=True))


def _pitcher() -> tuple[Shape, ...]:
    """A tapered wall, a bottom, and a handle towards the corner of the bounding box."""
    wall = _wall(12, (0.047, 0.004), (0.0575, 0.2418), 0.005)
    handle = _path(((0.036, 0.033, 0.215), (0.079, 0.075, 0.205), (0.079, 0.075, 0.085), (0.034, 0.031, 0.055)), 0.009)
    return (*_stack((0.047, 0.006)), *wall, *handle)


def _mug() -> tuple[Shape, ...]:
    """The wall ends above the bottom's underside, so that the mug stands on one shape instead of thirteen."""
    wall = _wall(12, (0.0435, 0.003), (0.0435, 0.081), 0.005)
    handle = _path(((0.042, 0.0, 0.066), (0.064, 0.0, 0.058), (0.064, 0.0, 0.026), (0.042, 0.0, 0.018)), 0.005)
    return (*_stack((0.043, 0.006)), *wall, *handle)


def _bowl() -> tuple[Shape, ...]:
    """A foot and two rings of panels, the upper one steeper, like a round shell."""
    lower = _wall(8, (0.036, 0.0025), (0.066, 0.026), 0.005)
    upper = _wall(12, (0.064, 0.025), (0.0777, 0.0547), 0.005)
    return (*_stack((0.040, 0.005)), *lower, *upper)


def _drill() -> tuple[Shape, ...]:
    """Motor with chuck along x, handle, and battery at the foot; y is up."""
    motor = _rod((-0.092, 0.0675, 0.0), (0.054, 0.0675, 0.0), 0.026, "cylinder")
    chuck = _rod((0.054, 0.0675, 0.0), (0.092, 0.0675, 0.0), 0.016, "cylinder")
    handle = _bar((-0.046, 0.060, 0.0), (-0.056, -0.055, 0.0), 0.040, 0.034)
    battery = Shape("box", (0.088, 0.045, 0.056), (-0.045, -0.071, 0.0))
    return motor, chuck, handle, battery


def _scissors() -> tuple[Shape, ...]:
    """Two bars crossing at the pivot, one above the other, each with a ring of four capsules."""
    shapes: list[Shape] = []
    for side in (-1.0, 1.0):
        corners = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))
        points = [(side * 0.0245 + 0.0155 * u, -0.069 + 0.024 * v, 0.0) for u, v in corners]
        shapes += _path(points, 0.0075, closed=True)
        shapes.append(_bar((side * 0.018, -0.044, side * 0.003), (-side * 0.006, 0.100, side * 0.003), 0.013, 0.006))
    return tuple(shapes)


def _clamp() -> tuple[Shape, ...]:
    """Two arms crossing at a pivot: handles that spread towards -x and jaws that close towards +x."""
    shapes = [_rod((0.020, 0.0, -0.0185), (0.020, 0.0, 0.0185), 0.020, "cylinder")]
    for side in (-1.0, 1.0):
        shapes.append(_bar((-0.0982, side * 0.0719, 0.0), (0.022, side * 0.008, 0.0), 0.024, 0.030))
        shapes.append(_bar((0.015, side * 0.015, 0.0), (0.070, side * 0.030, 0.0), 0.022, 0.030))
        shapes.append(_bar((0.066, side * 0.034, 0.0), (0.100, side * 0.012, 0.0), 0.018, 0.030))
    return tuple(shapes)


def _mustard() -> tuple[Shape, ...]:
    neck = _stack((0.027, 0.022), (0.018, 0.025), (0.006, 0.015))
    return (*_stadium(0.097, 0.066, 0.130, "x"), *_raised(neck, 0.130))


def _bleach() -> tuple[Shape, ...]:
    neck = _stack((0.030, 0.030), (0.016, 0.021), (0.021, 0.030))
    return (*_stadium(0.103, 0.068, 0.170, "x"), *_raised(neck, 0.170))


def _simple(name: str) -> tuple[Shape, ...]:
    """The box of the catalogue's extents, or the upright cylinder where the cross-section is round."""
    x, y, z = catalogue_object(name).extents
    return (Shape("cylinder", (x / 2, z)),) if name in _ROUND else (Shape("box", (x, y, z)),)


_ROUND = ("002_master_chef_can", "005_tomato_soup_can", "007_tuna_fish_can", "040_large_marker")

_COMPOUNDS = {
    "006_mustard_bottle": _mustard,
    "010_potted_meat_can": lambda: _stadium(0.097, 0.050, 0.089, "y"),
    "011_banana": _banana,
    "019_pitcher_base": _pitcher,
    "021_bleach_cleanser": _bleach,
    "024_bowl": _bowl,
    "025_mug": _mug,
    "035_power_drill": _drill,
    "037_scissors": _scissors,
    "052_extra_large_clamp": _clamp,
}

_SHAPES = {
    entry.name: _centred(_COMPOUNDS[entry.name]() if entry.name in _COMPOUNDS else _simple(entry.name))
    for entry in CATALOGUE
}
