"""The free objects: published sizes, sound mass properties, hollows that are hollow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from dgrasp.errors import DataError
from dgrasp.geometry.inertia import combine, shape_properties
from dgrasp.objects.catalogue import CATALOGUE, CatalogueObject, catalogue_object
from dgrasp.objects.free import free_object, shape_bounds
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape

each_object = pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: entry.name)


def surface(shape: Shape) -> Array:
    """(n, 3) points on a primitive's surface in its body's frame, its extreme ones among them to a fraction of a mm."""
    angles = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    if shape.kind == "box":
        local = np.array(np.meshgrid(*[(-s / 2, s / 2) for s in shape.size])).reshape(3, -1).T
    elif shape.kind == "cylinder":
        radius, length = shape.size
        ring = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros_like(angles)], axis=1)
        local = np.concatenate([np.add(ring, [0, 0, length / 2]), ring - [0, 0, length / 2]])
    else:
        radius, length = shape.size
        polar = np.linspace(0, np.pi, 121)[:, None]
        ball = radius * np.stack(
            [np.sin(polar) * np.cos(angles), np.sin(polar) * np.sin(angles), np.cos(polar) + 0 * angles], axis=-1
        ).reshape(-1, 3)
        local = np.concatenate([np.add(ball, [0, 0, length / 2]), ball - [0, 0, length / 2]])
    return local @ matrix_from_quaternion(np.array(shape.quaternion)).T + np.array(shape.position)


def distances(shapes: Sequence[Shape], points: Array) -> Array:
    """(n,) m from points (n, 3) to the nearest of some primitives; 0 or less inside."""
    found = []
    for shape in shapes:
        p = (points - np.array(shape.position)) @ matrix_from_quaternion(np.array(shape.quaternion))
        if shape.kind == "box":
            q = np.abs(p) - np.array(shape.size) / 2
        elif shape.kind == "cylinder":
            q = np.stack([np.hypot(p[:, 0], p[:, 1]) - shape.size[0], np.abs(p[:, 2]) - shape.size[1] / 2], axis=1)
        else:
            p[:, 2] -= np.clip(p[:, 2], -shape.size[1] / 2, shape.size[1] / 2)
            q = np.linalg.norm(p, axis=1)[:, None] - shape.size[0]
        found.append(np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0))
    return np.min(found, axis=0)


def distance(shapes: Sequence[Shape], point: Sequence[float]) -> float:
    """The same for one point."""
    return float(distances(shapes, np.array([point]))[0])


def touch(a: Shape, b: Shape) -> bool:
    """Whether the shapes come within 1 mm of each other, on a grid of points in `a` or in `b`."""
    for one, other in ((a, b), (b, a)):
        half = {"box": one.size, "cylinder": (0, 0, one.size[-1]), "capsule": (0, 0, one.size[-1])}[one.kind]
        grid = np.array(np.meshgrid(*[np.linspace(-h / 2, h / 2, 9) for h in half])).reshape(3, -1).T
        turned = grid @ matrix_from_quaternion(np.array(one.quaternion)).T + np.array(one.position)
        if distances([other], np.concatenate([turned, surface(one)])).min() < 1e-3:
            return True
    return False


@each_object
def test_extents_and_origin(entry: CatalogueObject) -> None:
    points = np.concatenate([surface(shape) for shape in free_object(entry.name, "ycb", False).shapes])
    low, high = points.min(axis=0), points.max(axis=0)
    assert high - low == pytest.approx(entry.extents, abs=0.003)
    assert low + high == pytest.approx(np.zeros(3), abs=2e-4)


@each_object
def test_shape_bounds_are_exact(entry: CatalogueObject) -> None:
    shapes = free_object(entry.name, "ycb", False).shapes
    points = np.concatenate([surface(shape) for shape in shapes])
    assert shape_bounds(shapes) == pytest.approx(np.stack([points.min(axis=0), points.max(axis=0)]), abs=2e-4)


@each_object
def test_mass_properties_are_sound(entry: CatalogueObject) -> None:
    model = free_object(entry.name, "ycb", official_compat=False)
    assert model.name == entry.name and model.mass == entry.mass_ycb
    volume = combine(shape_properties(shape) for shape in model.shapes).volume
    assert volume < 1.6 * np.prod(entry.extents)
    assert 100 < model.mass / volume < 1500
    low, middle, high = np.linalg.eigvalsh(model.inertia)
    assert low > 0 and high <= low + middle
    assert model.inertia == pytest.approx(model.inertia.T)
    assert np.all(np.abs(model.center_of_mass_O) < np.array(entry.extents) / 2)


@each_object
def test_contact_stays_cheap_and_connected(entry: CatalogueObject) -> None:
    shapes = free_object(entry.name, "ycb", False).shapes
    assert 1 <= len(shapes) <= 24
    assert all(np.linalg.norm(shape.quaternion) == pytest.approx(1) for shape in shapes)
    # All parts are connected: walk from each part to those that it touches.
    reached, waiting = {0}, [0]
    while waiting:
        part = waiting.pop()
        new = {i for i in range(len(shapes)) if i not in reached and touch(shapes[part], shapes[i])}
        reached |= new
        waiting += new
    assert len(reached) == len(shapes)


def test_compatible_object_has_the_authors_dynamics() -> None:
    model = free_object("025_mug", "official", official_compat=True)
    assert np.array_equal(model.inertia, np.eye(3)) and np.array_equal(model.center_of_mass_O, np.zeros(3))
    assert model.mass == 0.118


def test_both_mass_sets() -> None:
    assert free_object("021_bleach_cleanser", "official", False).mass == 0.302
    assert free_object("021_bleach_cleanser", "ycb", False).mass == 1.131


def test_inertia_scales_with_the_mass() -> None:
    light, heavy = (free_object("006_mustard_bottle", masses, False) for masses in ("official", "ycb"))
    assert heavy.inertia == pytest.approx(light.inertia * 0.603 / 0.431)


def test_unknown_object() -> None:
    with pytest.raises(DataError, match="unknown object '051_large_clamp'"):
        free_object("051_large_clamp", "official", True)


def test_soup_can_by_hand() -> None:
    model = free_object("005_tomato_soup_can", "ycb", False)
    # m = 0.349 kg, r = 0.033 m, h = 0.101 m: I_z = m r^2 / 2, I_x = m (3 r^2 + h^2) / 12.
    expected = 0.349 * (3 * 0.033**2 + 0.101**2) / 12
    assert np.diag(model.inertia) == pytest.approx([expected, expected, 0.349 * 0.033**2 / 2])


@pytest.mark.parametrize(("name", "center"), [("025_mug", (-0.0115, 0.0)), ("019_pitcher_base", (-0.014, -0.012))])
def test_vessels_are_hollow_down_to_a_bottom(name: str, center: tuple[float, float]) -> None:
    model = free_object(name, "ycb", False)
    half_height = catalogue_object(name).extents[2] / 2
    # A ball of 3 cm radius fits in the middle, and the mouth is open; below there is a bottom.
    assert distance(model.shapes, (*center, 0.0)) > 0.03
    assert distance(model.shapes, (*center, half_height)) > 0.03
    assert distance(model.shapes, (*center, -half_height + 0.003)) <= 0
    # The wall stands all around.
    for angle in np.linspace(0, 2 * np.pi, 60):
        radii = np.linspace(0.03, 0.07, 41)
        x, y = center[0] + radii * np.cos(angle), center[1] + radii * np.sin(angle)
        assert distances(model.shapes, np.stack([x, y, np.full(41, -0.01)], axis=1)).min() <= 0


def test_bowl_is_an_open_shell() -> None:
    shapes = free_object("024_bowl", "ycb", False).shapes
    assert distance(shapes, (0, 0, 0.01)) > 0.025
    assert distance(shapes, (0, 0, -0.026)) <= 0
    for angle in np.linspace(0, 2 * np.pi, 60):
        for z in (-0.015, 0.0, 0.02):
            radii = np.linspace(0.03, 0.09, 61)
            way = np.stack([radii * np.cos(angle), radii * np.sin(angle), np.full(61, z)], axis=1)
            assert distances(shapes, way).min() <= 0


def test_handles_and_rings_have_holes() -> None:
    pitcher = free_object("019_pitcher_base", "ycb", False).shapes
    # A finger of 1 cm radius fits between the pitcher and its handle.
    along = np.array([0.088, 0.084]) / np.hypot(0.088, 0.084)
    radii = np.linspace(0.05, 0.11, 61)
    gaps = [distance(pitcher, (-0.014 + r * along[0], -0.012 + r * along[1], 0.02)) for r in radii]
    inner = [i for i, gap in enumerate(gaps) if gap > 0.01]
    assert inner and any(gap <= 0 for gap in gaps[inner[-1] :])
    scissors = free_object("037_scissors", "ycb", False).shapes
    for side in (-1, 1):
        assert distance(scissors, (side * 0.0245, -0.069, 0.0)) > 0.006


def test_banana_is_bent() -> None:
    shapes = free_object("011_banana", "ycb", False).shapes
    low, high = shape_bounds(shapes)
    ends = np.array(shapes[0].position), np.array(shapes[-1].position)
    middle = np.array(shapes[2].position)
    assert np.linalg.norm(middle - (ends[0] + ends[1]) / 2) > 0.02
    assert (high - low)[2] == pytest.approx(0.037, abs=1e-9)


def test_bounds_of_a_mesh_need_its_file() -> None:
    with pytest.raises(ValueError, match="expected a primitive"):
        shape_bounds([Shape("hull")])
