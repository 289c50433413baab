"""The cutter: its hulls hold the solid, and their surfaces reach no farther beyond it than the tolerance."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import manifold3d
import numpy as np
import pytest
import trimesh

from dgrasp.geometry.inside import inside_hull
from dgrasp.objects.add.cut import cut
from dgrasp.objects.add.repair import repair
from dgrasp.types import Array

TOLERANCE, WIDE = 0.002, 0.003
"""m. The mug is cut less finely, which is quicker."""
SLACK = 0.0003
"""m. Between the points of its surface that are looked at, a hull may reach a little farther than the tolerance."""
Hulls = list[Array]


def made(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    return repair(np.asarray(mesh.vertices), np.asarray(mesh.faces)).solid


def held(hulls: Hulls, points: Array) -> Array:
    return np.any([inside_hull(hull, points) for hull in hulls], axis=0)


def in_box(low: tuple[float, ...], high: tuple[float, ...], count: int = 4000) -> Array:
    return np.random.default_rng(0).uniform(low, high, (count, 3))


@cache
def hoop() -> Hulls:
    """A ring of radius 30 mm, of a tube of radius 4 mm."""
    return cut(made(trimesh.creation.torus(0.03, 0.004, major_sections=32, minor_sections=8)), TOLERANCE, 64)


@cache
def bowl() -> Hulls:
    """Half a hollow ball of radius 40 mm, open towards +z, with a wall of 4 mm."""
    ball = manifold3d.Manifold.sphere
    return cut((ball(0.04, 32) - ball(0.036, 32)).trim_by_plane((0.0, 0.0, -1.0), 0.0), TOLERANCE, 64)


@cache
def mug() -> Hulls:
    """A cup of radius 30 mm, 60 mm high, with walls of 4 mm, and at +x a handle of a tube of radius 4 mm."""

    def cylinder(radius: float) -> manifold3d.Manifold:
        return manifold3d.Manifold.cylinder(0.06, radius, circular_segments=24)

    cup = cylinder(0.03) - cylinder(0.026).translate((0.0, 0.0, 0.004))
    ring = made(trimesh.creation.torus(0.018, 0.004, major_sections=16, minor_sections=6))
    handle = ring.rotate((90.0, 0.0, 0.0)).translate((0.04, 0.0, 0.03)) - cylinder(0.028)
    return cut(cup + handle, WIDE, 64)


def from_hoop(points: Array) -> Array:
    """Distance from the hoop, negative inside."""
    return np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.03, points[:, 2]) - 0.004


def from_bowl(points: Array) -> Array:
    """Distance from the bowl, negative inside; near its rim, a little less."""
    radius = np.linalg.norm(points, axis=1)
    return np.maximum(np.maximum(radius - 0.04, 0.036 - radius), points[:, 2])


def from_mug(points: Array) -> Array:
    """Distance from the mug, negative inside; near its edges, a little less."""
    x, y, z = points.T
    rho = np.hypot(x, y)
    cup = np.maximum.reduce([rho - 0.03, -z, z - 0.06, np.minimum(0.026 - rho, z - 0.004)])
    ring = np.hypot(np.hypot(x - 0.04, z - 0.03) - 0.018, y) - 0.004
    return np.minimum(cup, np.maximum(ring, 0.028 - rho))


SHAPES: dict[str, tuple[Callable[[], Hulls], Callable[[Array], Array], Array]] = {
    "hoop": (hoop, from_hoop, in_box((-0.04, -0.04, -0.008), (0.04, 0.04, 0.008))),
    "bowl": (bowl, from_bowl, in_box((-0.045, -0.045, -0.045), (0.045, 0.045, 0.005))),
    "mug": (mug, from_mug, in_box((-0.035, -0.035, -0.005), (0.065, 0.035, 0.065), 12000)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_thin_solids_are_held_and_their_hollows_are_free(name: str) -> None:
    make, distance, points = SHAPES[name]
    hulls = make()
    assert 1 < len(hulls) <= 64 and all(len(hull) >= 4 for hull in hulls)
    far, inside = distance(points), held(hulls, points)
    # The meshes are polygons in the round shapes: what lies 0.6 mm deep lies in them too.
    assert inside[far < -0.0006].mean() > 0.99
    assert far[inside].max() < (WIDE if name == "mug" else TOLERANCE) + SLACK


def test_the_hollows_of_the_mug_stay_open() -> None:
    rho, turn = 0.026 * np.random.default_rng(1).random(4000) ** 0.5, np.linspace(0.0, 200.0, 4000)
    height = np.random.default_rng(2).uniform(0.004, 0.06, 4000)
    cup = np.column_stack([rho * np.cos(turn), rho * np.sin(turn), height])
    assert held(mug(), cup).mean() < 0.15
    ring = np.column_stack([0.04 + 0.014 / 0.026 * cup[:, 0], np.zeros(4000), 0.03 + 0.014 / 0.026 * cup[:, 1]])
    assert held(mug(), ring[ring[:, 0] > 0.03]).mean() < 0.2


def test_a_convex_solid_is_its_own_hull() -> None:
    (hull,) = cut(manifold3d.Manifold.cube((0.06, 0.05, 0.04), True), TOLERANCE, 64)
    assert sorted(map(tuple, np.abs(hull))) == [(0.03, 0.025, 0.02)] * 8


def test_what_is_apart_stays_apart_while_there_are_hulls_enough() -> None:
    cube = manifold3d.Manifold.cube((0.02, 0.02, 0.02), True)
    two = cube + cube.translate((0.05, 0.0, 0.0))
    assert sorted(hull[:, 0].max() for hull in cut(two, TOLERANCE, 2)) == pytest.approx([0.01, 0.06])
    (one,) = cut(two, TOLERANCE, 1)
    assert one[:, 0].min() == pytest.approx(-0.01) and one[:, 0].max() == pytest.approx(0.06)


def test_few_hulls_still_hold_the_solid() -> None:
    ring = made(trimesh.creation.torus(0.03, 0.004, major_sections=32, minor_sections=8))
    hulls = cut(ring, TOLERANCE, 6)
    turn = np.linspace(0.0, 2.0 * np.pi, 100)
    middle = 0.0299 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(100)])
    assert len(hulls) <= 6 and held(hulls, middle).all()
    far = from_hoop(np.concatenate(hulls))
    # The corners are the mesh's, or on its edges, and those are inside the round tube but for its cut edges.
    assert far.max() < 2e-4


def test_the_same_solid_gives_the_same_hulls() -> None:
    ring = trimesh.creation.torus(0.03, 0.004, major_sections=32, minor_sections=8)
    first, second = hoop(), cut(made(ring), TOLERANCE, 64)
    assert len(first) == len(second) and all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_a_mesh_that_cuts_through_itself() -> None:
    # An L of 10 mm bars. Two faces of one bar are pushed through each other, so that it encloses a negative volume.
    outline = [(0.0, 0.0), (0.05, 0.0), (0.05, 0.01), (0.01, 0.01), (0.01, 0.05), (0.0, 0.05)]
    plain = manifold3d.CrossSection([outline]).extrude(0.01).refine_to_length(0.005)
    mesh = plain.to_mesh64()
    vertices = np.array(mesh.vert_properties[:, :3], order="C")
    low = (vertices[:, 0] > 0.03) & (vertices[:, 1] < 1e-9)
    vertices[low, 1] = 0.012
    crossed = manifold3d.Manifold(manifold3d.Mesh64(vertices, np.array(mesh.tri_verts, dtype=np.uint64, order="C")))
    assert crossed.volume() < 0.8 * plain.volume()
    hulls = cut(crossed, TOLERANCE, 64)
    # Booleans of such a solid lose a little of it, here 4% of the sound bars.
    corner = in_box((0.014, 0.014, 0.0), (0.05, 0.05, 0.01))
    bars = np.concatenate([in_box((0.0, 0.0, 0.0), (0.024, 0.01, 0.01)), in_box((0.0, 0.0, 0.0), (0.01, 0.05, 0.01))])
    assert len(hulls) <= 12 and held(hulls, corner).mean() < 0.02 and held(hulls, bars).mean() > 0.95
