"""Bodies that lie on a table stay where they are, and round ones roll down slopes as they should."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from dgrasp.config.sections import ActionConfig, PhysicsConfig
from dgrasp.objects.model import ObjectModel
from dgrasp.types import Array
from raisim_like import RigidBody, Shape, World, integrate
from raisim_like.batch import Preset
from raisim_like.engines.bullet.rest import ends
from raisim_like.rotations import transform
from tests.raisim_like.test_rigid_body import wxyz
from tests.scenes import OneScene, free_hand

DT, G = 0.00222, 9.81
LYING = Rotation.from_euler("y", 90, degrees=True)


def solid_cylinder(radius: float, length: float, mass: float) -> Array:
    side = mass * (3 * radius**2 + length**2) / 12
    return np.diag([side, side, mass * radius**2 / 2])


def bar(path: Path, low: float, high: float, sides: int = 16, radius: float = 0.008) -> Shape:
    """A hull with `sides` sides between two heights."""
    mesh = trimesh.creation.cylinder(radius, high - low, sections=sides)
    mesh.apply_translation([0, 0, (low + high) / 2])
    mesh.export(path)
    return Shape("hull", file=path)


def lay_out(world: World, mass: float, folder: Path) -> list[tuple[RigidBody, Array]]:
    """One body of each kind on the ground, a metre apart, with the state that each was given."""
    flat = 0.008 * np.cos(np.pi / 16)
    on_a_face = LYING * Rotation.from_euler("z", np.pi / 16)
    thin, can = (0.008, 0.14), (0.0335, 0.1)
    halves = [bar(folder / "low.obj", -0.07, 0.0), bar(folder / "high.obj", 0.0, 0.07)]
    laid = [
        ([Shape("cylinder", thin)], thin, LYING, 0.008),
        ([Shape("cylinder", can)], can, LYING, 0.0335),
        ([Shape("cylinder", can)], can, Rotation.identity(), 0.05),
        ([Shape("capsule", thin)], thin, LYING, 0.008),
        ([bar(folder / "whole.obj", -0.07, 0.07)], thin, on_a_face, flat),
        (halves, thin, on_a_face, flat),
    ]
    bodies = []
    for i, (shapes, (radius, length), rotation, height) in enumerate(laid):
        body = world.add_body(shapes, mass, solid_cylinder(radius, length, mass))
        body.set_state((0.3, i, height), wxyz(Rotation.from_euler("z", 0.4 + i) * rotation))
        bodies.append((body, body.state))
    return bodies


@pytest.mark.parametrize("preset", ["faithful", "fast"])
@pytest.mark.parametrize(("mass", "friction"), [(0.002, 0.1), (0.06, 2.0), (1.0, 0.8)])
def test_what_lies_untouched_stays(engine: str, preset: Preset, mass: float, friction: float, tmp_path: Path) -> None:
    world = World(engine, DT, preset)
    world.set_default_material(friction)
    world.add_ground()
    bodies = lay_out(world, mass, tmp_path)
    world.integrate(round(5.0 / DT))
    for body, start in bodies:
        state = body.state
        turned = Rotation.from_quat(state[[4, 5, 6, 3]]) * Rotation.from_quat(start[[4, 5, 6, 3]]).inv()
        assert np.linalg.norm(state[:3] - start[:3]) < 1e-3, body.id
        assert np.degrees(turned.magnitude()) < 1.0, body.id
    world.close()


@pytest.mark.parametrize(("radius", "length", "sides", "mass", "friction"),
                         [(0.007, 0.128, 38, 0.7, 0.4), (0.0106, 0.057, 43, 0.058, 0.8), (0.0066, 0.182, 36, 0.2, 0.4)])
def test_a_hull_stays_on_a_narrow_face(
    engine: str, radius: float, length: float, sides: int, mass: float, friction: float, tmp_path: Path
) -> None:
    world = World(engine, DT, "fast")
    world.set_default_material(friction)
    world.add_ground()
    shape = bar(tmp_path / "bar.obj", -length / 2, length / 2, sides, radius)
    body = world.add_body([shape], mass, solid_cylinder(radius, length, mass))
    on_a_face = LYING * Rotation.from_euler("z", np.pi / sides)
    body.set_state((0.1, 0.05, radius * np.cos(np.pi / sides)), wxyz(Rotation.from_euler("z", 2.0) * on_a_face))
    start = body.state
    world.integrate(round(5.0 / DT))
    turned = Rotation.from_quat(body.state[[4, 5, 6, 3]]) * Rotation.from_quat(start[[4, 5, 6, 3]]).inv()
    assert np.linalg.norm(body.state[:3] - start[:3]) < 1e-3 and np.degrees(turned.magnitude()) < 1.0
    world.close()


def hull_of(path: Path, mesh: trimesh.Trimesh, z: float = 0.0) -> Shape:
    """The hull of a mesh, moved along z, with all digits: a face of four corners must stay flat."""
    moved = mesh.vertices + np.array([0.0, 0.0, z])
    path.write_text("".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in moved.tolist())
                    + "".join("f {} {} {}\n".format(*face) for face in (mesh.faces + 1).tolist()))
    return Shape("hull", file=path)


def on_a_side(points: Array, center: Array) -> tuple[Rotation, float]:
    """Turn and height of the origin that lay a body of revolution (N, 3) about z on the side face nearest below it."""
    faces = ConvexHull(points).equations
    sides = faces[np.abs(faces[:, 2]) < 0.9]
    # Of all tangents to the side, a body rests on the one that is nearest to the centre of mass.
    normal = sides[np.argmin(-(sides[:, :3] @ center + sides[:, 3])), :3]
    turn = Rotation.align_vectors([[0, 0, -1]], [normal])[0]
    return turn, float(-turn.apply(points)[:, 2].min())


@pytest.mark.parametrize("preset", ["faithful", "fast"])
@pytest.mark.parametrize(("mass", "friction"), [(0.06, 0.1), (1.0, 0.8)])
def test_dumb_bells_and_cones_stay_in_their_resting_poses(
    engine: str, preset: Preset, mass: float, friction: float, tmp_path: Path
) -> None:
    """Poses are those of the convex hull. A dumb-bell whose ends differ lies askew, here by atan(5 / 100)."""
    world = World(engine, DT, preset)
    world.set_default_material(friction)
    world.add_ground()
    bodies = []

    def lay(shapes: list[Shape], inertia: Array, center: Array, turn: Rotation, height: float) -> None:
        body = world.add_body(shapes, mass, inertia, center)
        body.set_state((0.3, len(bodies), height), wxyz(Rotation.from_euler("z", 0.4 + len(bodies)) * turn))
        bodies.append((body, body.state))

    # Two discs of 15 mm, of radii 20 and 15 mm, at 50 mm below and above the origin.
    wide, narrow, low, high = 0.02, 0.015, np.array([0, 0, -0.05]), np.array([0, 0, 0.05])
    share = wide**2 / (wide**2 + narrow**2)
    center = share * low + (1 - share) * high
    inertia = sum(solid_cylinder(r, 0.015, m) + m * (at - center)[2] ** 2 * np.diag([1, 1, 0])
                  for r, m, at in ((wide, share * mass, low), (narrow, (1 - share) * mass, high)))
    askew = np.arctan(0.05)
    lay([Shape("cylinder", (r, 0.015), (0, 0, z)) for r, z in ((wide, -0.05), (narrow, 0.05))], inertia, center,
        Rotation.from_euler("y", np.pi / 2 + askew), (wide - 0.05 * 0.0425) * np.cos(askew))
    for sides in (16, 32):
        discs = [trimesh.creation.cylinder(r, 0.015, sections=sides) for r in (wide, narrow)]
        shapes = [hull_of(tmp_path / f"{sides}_{z}.obj", disc, z) for disc, z in zip(discs, (-0.05, 0.05), strict=True)]
        points = np.concatenate([discs[0].vertices + low, discs[1].vertices + high])
        lay(shapes, inertia, center, *on_a_side(points, center))
    for sides in (16, 64):
        cone = trimesh.creation.cone(0.03, 0.1, sections=sides)
        cone.density = mass / cone.volume
        turn, height = on_a_side(cone.vertices, cone.center_mass)
        lay([hull_of(tmp_path / f"cone_{sides}.obj", cone)], cone.moment_inertia, cone.center_mass, turn, height)
    world.integrate(round(5.0 / DT))
    for body, start in bodies:
        turned = Rotation.from_quat(body.state[[4, 5, 6, 3]]) * Rotation.from_quat(start[[4, 5, 6, 3]]).inv()
        assert np.linalg.norm(body.state[:3] - start[:3]) < 1e-3, body.id
        assert np.degrees(turned.magnitude()) < 1.0, body.id
    world.close()


@pytest.mark.parametrize("preset", ["faithful", "fast"])
def test_a_pencil_that_stands_beside_a_hand_stays(engine: str, preset: Preset) -> None:
    """A hand's weight in the solver, 13 steps at a time, as in a scene."""
    inertia = np.diag([1.53e-5, 1.53e-5, 3.06e-8])
    # A fitted shape is turned by rounding, and Bullet's arithmetic then differs.
    shape = Shape("cylinder", (0.0031291887129068713, 0.175), quaternion=(0.9999999999999931, 0.0, 0.0, 1.18e-7))
    pencil = ObjectModel("pencil", (shape,), 0.006, np.zeros(3), inertia)
    scene = OneScene(free_hand(), pencil, PhysicsConfig(preset=preset), engine)
    T_WO = transform(Rotation.from_euler("z", 0.3).as_matrix(), np.array([0.5, 0.2, 0.5 + 0.0875]))
    scene.place(transform(np.eye(3), np.array([0.5, -0.3, 1.5])), np.zeros(45), T_WO, 0.5)
    scene.set_gains(ActionConfig(), 1000.0, 0.0)
    scene.set_target(np.zeros(51))
    start = scene.state.bodies[0, 0].copy()
    scene.advance(225)
    scene.advance(round(5.0 / DT) - 225)
    state = scene.state.bodies[0, 0]
    turned = Rotation.from_quat(state[[4, 5, 6, 3]]) * Rotation.from_quat(start[[4, 5, 6, 3]]).inv()
    assert np.linalg.norm(state[:3] - start[:3]) < 1e-3 and np.degrees(turned.magnitude()) < 1.0
    scene.close()


def test_bars_stay_at_low_friction_however_they_lie(engine: str) -> None:
    world = World(engine, DT)
    world.set_default_material(0.1)
    world.add_ground()
    bars = [world.add_body([Shape("cylinder", (0.008, 0.14))], 0.06, solid_cylinder(0.008, 0.14, 0.06))
            for _ in range(8)]  # fmt: skip
    starts = [np.array([0.3 * i, 0.2 * i, 0.008]) for i in range(len(bars))]
    for i, (one, start) in enumerate(zip(bars, starts, strict=True)):
        one.set_state(start, wxyz(Rotation.from_euler("z", 0.7 * i) * LYING))
    world.integrate(round(5.0 / DT))
    assert np.array([one.position for one in bars]) == pytest.approx(np.array(starts), abs=1e-3)
    world.close()


@pytest.mark.parametrize("preset", ["faithful", "fast"])
@pytest.mark.parametrize(("radius", "length", "mass"), [(0.008, 0.14, 0.012), (0.0335, 0.1, 0.35)])
def test_a_cylinder_rolls_down_a_slope(engine: str, preset: Preset, radius: float, length: float, mass: float) -> None:
    """It gains 2/3 g sin a and neither sinks nor turns, from 8 degrees for half a second."""
    slope, steps = np.radians(8.0), 230
    world = World(engine, DT, preset)
    world.set_default_material(0.8)
    world.set_gravity((G * np.sin(slope), 0, -G * np.cos(slope)))
    world.add_ground()
    body = world.add_body([Shape("cylinder", (radius, length))], mass, solid_cylinder(radius, length, mass))
    body.set_state((0, 0.1, radius), wxyz(Rotation.from_euler("x", 90, degrees=True)))
    world.integrate(steps)
    speed = 2 / 3 * G * np.sin(slope) * steps * DT
    assert body.linear_velocity[0] == pytest.approx(speed, rel=0.03)
    assert body.angular_velocity[1] == pytest.approx(speed / radius, rel=0.03)
    assert body.position[1:] == pytest.approx([0.1, radius], abs=2e-4)
    world.close()


def test_ends_lie_inside_their_shape() -> None:
    """Along z turned to x: a bar 140 mm long ends at 70 mm, its discs of 4 mm are centred at 68."""
    quarter = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
    discs = list(ends([Shape("cylinder", (0.008, 0.14), (0.1, 0, 0), quarter), Shape("box", (1, 1, 1))]))
    assert [(disc.kind, disc.size) for disc in discs] == [("cylinder", (0.008, 0.004))] * 2
    assert discs[0].position == pytest.approx((0.168, 0, 0)) and discs[1].position == pytest.approx((0.032, 0, 0))
    balls = list(ends([Shape("capsule", (0.02, 0.1))]))
    assert [(ball.kind, ball.position) for ball in balls] == [("sphere", (0, 0, 0.05)), ("sphere", (0, 0, -0.05))]


def test_ends_touch_static_bodies_alone(engine: str) -> None:
    """A can on a can on the ground: the cans have one pair of shapes, which keeps no more than four points."""
    world = World(engine, DT)
    ground, below, above = world.add_ground(), world.add_cylinder(0.03, 0.1, 0.3), world.add_cylinder(0.03, 0.1, 0.3)
    below.set_state((0, 0, 0.05))
    above.set_state((0, 0, 0.15))
    world.integrate(200)
    found = above.contacts()
    assert 1 <= len(found) <= 4
    assert {(c.body_b, c.link_a, c.link_b) for c in found} == {(below.id, -1, -1)}
    carried = sum(c.impulse for c in below.contacts() if c.body_b == ground.id)
    assert carried == pytest.approx(0.6 * G * DT, rel=0.02)
    world.close()


def test_a_world_with_a_round_body_leaves_others_alone(engine: str) -> None:
    """Bullet's contact breaking threshold belongs to a process, and round bodies need another one."""

    def tumble(other: bool) -> Array:
        worlds = [World(engine, DT) for _ in range(1 + other)]
        for world in worlds:
            world.add_ground()
            body = world.add_box(0.06, 0.04, 0.1, 0.3) if world is worlds[-1] else world.add_cylinder(0.03, 0.1, 0.3)
            body.set_state((0, 0, 0.07), wxyz(Rotation.from_euler("xyz", [0.5, 0.3, 0])), angular=(3, 0, 1))
        states = []
        for _ in range(40):
            integrate(worlds, 5)
            states.append(worlds[-1].objects[1].state)
        for world in worlds:
            world.close()
        return np.array(states)

    assert np.array_equal(tumble(other=False), tumble(other=True))
