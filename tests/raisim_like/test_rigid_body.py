"""Rigid bodies against the closed forms of mechanics."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.types import Array
from raisim_like import EngineError, RigidBody, Shape, World

DT, G = 0.00222, 9.81
TURN = Rotation.from_rotvec([0.4, -0.9, 0.7])
AXES = Rotation.from_rotvec([1.0, 0.3, -0.5]).as_matrix()
INERTIA = AXES @ np.diag([1.0e-3, 2.0e-3, 2.5e-3]) @ AXES.T
COM = np.array([0.02, -0.03, 0.05])


@pytest.fixture
def world(engine: str) -> Iterator[World]:
    made = World(engine, DT)
    yield made
    made.close()


def wxyz(rotation: Rotation) -> Array:
    return rotation.as_quat(canonical=True)[[3, 0, 1, 2]]


def test_free_fall_is_semi_implicit_euler(world: World) -> None:
    box = world.add_box(0.1, 0.2, 0.3, 1.5)
    box.set_state((0, 0, 5), linear=(0.3, 0, 1))
    n = 200
    world.integrate(n)
    assert box.linear_velocity == pytest.approx([0.3, 0, 1 - n * G * DT], abs=1e-13)
    # v_k = v_0 - k g dt; the position sums these, k from 1 to n.
    assert box.position == pytest.approx([0.3 * n * DT, 0, 5 + n * DT - G * DT**2 * n * (n + 1) / 2], abs=1e-13)
    # Against the parabola: the difference is half a substep times the velocity.
    t = n * DT
    assert box.position[2] == pytest.approx(5 + t - G * t**2 / 2, abs=1.01 * G * DT * t / 2)


def slope(world: World, tangent: float, friction: float) -> tuple[RigidBody, Array]:
    """A flat block on a plane that falls towards +x; the plane's rotation."""
    tilt = Rotation.from_rotvec([0, np.arctan(tangent), 0])
    world.set_default_material(friction)
    plane = world.add_body([Shape("box", (20, 20, 1))], 0.0, np.eye(3))
    plane.set_state(tilt.apply([0, 0, -0.5]), wxyz(tilt))
    block = world.add_box(0.3, 0.3, 0.06, 1.0)
    block.set_state(tilt.apply([0, 0, 0.03]), wxyz(tilt))
    return block, tilt.as_matrix()


@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_a_block_holds_below_the_friction_angle(world: World, friction: float) -> None:
    block, R = slope(world, 0.97 * friction, friction)
    world.integrate(400)
    along = R.T @ block.position
    assert abs(along[0]) < 1e-4 and abs(along[1]) < 1e-4
    assert np.abs(block.linear_velocity).max() < 1e-6


@pytest.mark.parametrize(("friction", "tangent"), [(0.3, 0.33), (0.3, 0.6), (0.8, 0.85), (0.8, 1.1)])
def test_a_block_slides_above_the_friction_angle(world: World, friction: float, tangent: float) -> None:
    block, R = slope(world, tangent, friction)
    world.integrate(400)
    angle = np.arctan(tangent)
    expected = G * (np.sin(angle) - friction * np.cos(angle))
    assert (R.T @ block.linear_velocity)[0] / (400 * DT) == pytest.approx(expected, rel=0.02)


def test_a_sliding_block_stops_after_its_braking_distance(world: World) -> None:
    world.set_default_material(0.5)
    world.add_ground()
    block = world.add_box(0.3, 0.3, 0.06, 1.0)
    block.set_state((0, 0, 0.03), linear=(1.5, 0, 0))
    world.integrate(130)  # It needs v / (mu g) = 0.3058 s, 138 substeps.
    assert block.linear_velocity[0] > 0.05
    world.integrate(170)
    # MuJoCo's contacts are a ten-thousandth soft, and creep.
    assert np.abs(block.linear_velocity).max() < (1e-9 if world.engine.name == "pybullet" else 2e-6)
    assert block.position[0] == pytest.approx(1.5**2 / (2 * 0.5 * G), rel=0.01)


@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_collisions_keep_momentum_and_lose_the_normal_velocity(world: World, offset: float) -> None:
    world.set_gravity((0, 0, 0))
    first, second = world.add_sphere(0.05, 1.0), world.add_sphere(0.05, 2.5)
    first.set_state((0, 0, 0), linear=(1, 0, 0))
    second.set_state((0.3, offset, 0), linear=(-0.2, 0, 0))

    def spin(body: RigidBody, mass: float) -> Array:
        return mass * np.cross(body.position, body.linear_velocity) + 0.4 * mass * 0.05**2 * body.angular_velocity

    before = spin(first, 1.0) + spin(second, 2.5)
    world.integrate(150)
    assert 1.0 * first.linear_velocity + 2.5 * second.linear_velocity == pytest.approx([0.5, 0, 0], abs=1e-11)
    assert spin(first, 1.0) + spin(second, 2.5) == pytest.approx(before, abs=1e-4)
    if offset == 0.0:
        assert first.linear_velocity[0] == pytest.approx(0.5 / 3.5, abs=1e-11)
        assert second.linear_velocity[0] == pytest.approx(0.5 / 3.5, abs=1e-11)
    else:
        assert second.linear_velocity[1] > 0.01 > -0.01 > first.linear_velocity[1]


@pytest.mark.parametrize(
    ("shape", "lowest"),
    [
        (Shape("box", (0.1, 0.2, 0.3)), 0.15),
        (Shape("sphere", (0.07,)), 0.07),
        (Shape("cylinder", (0.05, 0.2)), 0.1),
        (Shape("capsule", (0.05, 0.2)), 0.15),
        (Shape("box", (0.1, 0.1, 0.1), position=(0, 0, -0.2)), 0.25),
        (Shape("cylinder", (0.05, 0.2), quaternion=(np.sqrt(0.5), np.sqrt(0.5), 0, 0)), 0.05),
    ],
)
def test_bodies_rest_on_their_lowest_point(world: World, shape: Shape, lowest: float) -> None:
    world.add_ground(0.5)
    body = world.add_body([shape], 1.0, np.eye(3), center_of_mass=(0, 0, shape.position[2]))
    body.set_state((0, 0, 0.5 + lowest + 0.002))
    world.integrate(300)
    # Without error reduction a body stays as deep as its last step before contact took it, at most g t dt = 1 mm.
    assert body.position[2] == pytest.approx(0.5 + lowest, abs=1.1e-3)
    assert np.abs(body.linear_velocity).max() < 1e-3


def write_cube(path: Path) -> Path:
    """A cube of 0.1 m as a file of triangles."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = ["1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"]
    lines = [f"v {0.05 * x} {0.05 * y} {0.05 * z}" for x, y, z in corners]
    for face in faces:
        a, b, c, d = face.split()
        lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("kind", ["hull", "mesh"])
def test_mesh_files_collide(world: World, tmp_path: Path, kind: str) -> None:
    file = write_cube(tmp_path / "cube.obj")
    world.add_ground()
    if kind == "mesh" and world.engine.name == "mujoco":
        with pytest.raises(EngineError, match=r"cube\.obj: MuJoCo has no concave meshes.* give the body convex parts"):
            world.add_body([Shape("mesh", file=file)], 1.0, np.eye(3))
        return
    body = world.add_body([Shape(kind, file=file)], 1.0, np.eye(3))  # type: ignore[arg-type]
    body.set_state((0, 0, 0.052))
    world.integrate(200)
    assert body.position[2] == pytest.approx(0.05, abs=1.6e-3)


def test_compounds_keep_their_frame_whatever_the_centre_of_mass(world: World) -> None:
    world.add_ground()
    shapes = [Shape("box", (0.1, 0.1, 0.02), (0, 0, -0.04)), Shape("cylinder", (0.01, 0.08), (0, 0, 0.01))]
    body = world.add_body(shapes, 1.0, INERTIA, (0.01, 0, -0.02))
    body.set_state((0, 0, 0.05))
    world.integrate(200)
    assert body.position == pytest.approx([0, 0, 0.05], abs=1e-4)
    points = np.array([contact.point_W for contact in body.contacts()])
    assert np.abs(np.abs(points[:, :2]) - 0.05).max() < 1e-3


def test_the_state_round_trips_with_an_offset_centre_of_mass(world: World) -> None:
    body = world.add_body([Shape("box", (0.1, 0.1, 0.1))], 1.0, INERTIA, COM)
    state = [(1.0, -2.0, 0.5), wxyz(TURN), (0.3, 0.1, -0.7), (2.0, -1.0, 0.4)]
    body.set_state(*state)
    assert body.state == pytest.approx(np.concatenate(state), abs=1e-12)
    assert body.rotation == pytest.approx(TURN.as_matrix(), abs=1e-12)


def test_a_free_body_turns_about_its_centre_of_mass(world: World) -> None:
    world.set_gravity((0, 0, 0))
    body = world.add_body([Shape("box", (0.1, 0.1, 0.1))], 1.0, INERTIA, COM)
    R = TURN.as_matrix()
    omega = 4.0 * R @ AXES[:, 2]  # Along a principal axis, so it stays.
    body.set_state((0, 0, 0), wxyz(TURN), -np.cross(omega, R @ COM), omega)
    n = 200
    world.integrate(n)
    assert body.position + body.rotation @ COM == pytest.approx(R @ COM, abs=1e-12)
    assert body.angular_velocity == pytest.approx(omega, abs=1e-12)
    assert Rotation.from_matrix(body.rotation @ R.T).as_rotvec() == pytest.approx(omega * n * DT, abs=1e-12)


def test_a_tumbling_body_keeps_its_angular_momentum(world: World) -> None:
    world.set_gravity((0, 0, 0))
    body = world.add_body([Shape("box", (0.1, 0.1, 0.1))], 1.0, INERTIA, COM)
    R, omega = TURN.as_matrix(), np.array([1.0, 2.0, 3.0])
    body.set_state((0, 0, 0), wxyz(TURN), -np.cross(omega, R @ COM), omega)
    momentum = R @ INERTIA @ R.T @ omega
    world.integrate(200)
    now = body.rotation @ INERTIA @ body.rotation.T @ body.angular_velocity
    assert np.linalg.norm(now - momentum) < 0.005 * np.linalg.norm(momentum)


def test_static_bodies_stay(world: World) -> None:
    wall = world.add_body([Shape("box", (1, 1, 1))], 0.0, np.eye(3))
    wall.set_state((0, 0, 2), wxyz(TURN))
    before = wall.state
    world.add_sphere(0.1, 50.0).set_state((0, 0, 3.2))
    world.integrate(100)
    assert wall.state.tolist() == before.tolist()


def test_bad_bodies_are_refused(world: World, tmp_path: Path) -> None:
    with pytest.raises(EngineError, match="at least one shape"):
        world.add_body([], 1.0, np.eye(3))
    with pytest.raises(EngineError, match=r"absent\.obj does not exist"):
        world.add_body([Shape("hull", file=tmp_path / "absent.obj")], 1.0, np.eye(3))
    for mass in (np.nan, -1.0):
        with pytest.raises(ValueError, match="a mass of"):
            world.add_sphere(0.1, mass)
    (tmp_path / "damaged.obj").write_text("v 0 0")
    with pytest.raises(EngineError):
        world.add_body([Shape("hull", file=tmp_path / "damaged.obj")], 1.0, np.eye(3))
        world.integrate(1)  # MuJoCo's world is built here
    body = world.add_sphere(0.1, 1.0)
    with pytest.raises(ValueError, match="finite"):
        body.set_state((0, 0, np.nan))
    with pytest.raises(ValueError, match="position 3"):
        body.set_state((0, 0))


def test_a_compound_of_many_parts_is_one_solid_body(world: World) -> None:
    """24 plates side by side, more than PyBullet's arrays of shapes hold, lie on the ground as one slab."""
    world.add_ground()
    shapes = [Shape("box", (0.01, 0.2, 0.02), (0.01 * (i - 11.5), 0.0, 0.0)) for i in range(24)]
    slab = world.add_body(shapes, 0.5, 0.5 / 12 * np.diag([0.04, 0.0576, 0.0976]))
    slab.set_state((0.0, 0.0, 0.0101))
    world.integrate(450)
    assert slab.position == pytest.approx([0.0, 0.0, 0.01], abs=1e-3)
    assert slab.rotation[2, 2] == pytest.approx(1.0, abs=1e-4)
    assert sum(c.impulse for c in slab.contacts()) == pytest.approx(0.5 * 9.81 * world.timestep, rel=0.05)


def test_bullet_s_solver_works_longer_while_a_light_body_is_in_the_world() -> None:
    pybullet = pytest.importorskip("pybullet")
    world = World("pybullet", DT)

    def iterations() -> int:
        client = world.engine_world.client  # type: ignore[attr-defined]
        return int(pybullet.getPhysicsEngineParameters(client)["numSolverIterations"])

    world.add_ground()
    world.add_box(0.1, 0.1, 0.1, 0.05)
    assert iterations() == 100
    marker = world.add_box(0.02, 0.02, 0.12, 0.0158)
    assert iterations() == 500
    world.remove(marker)
    assert iterations() == 100
    world.close()
