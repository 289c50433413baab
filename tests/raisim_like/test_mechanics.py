"""External forces, momenta and energies of bodies and systems, against the formulas of mechanics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.hand.free.hand import URDF_PATH
from dgrasp.types import Array
from raisim_like import ArticulatedSystem, RigidBody, Shape, World
from tests.raisim_like.test_rigid_body import COM, INERTIA, TURN, wxyz
from tests.raisim_like.test_urdf import ARM, read
from tests.raisim_like.urdfs import mass_matrix, write_chain

DT, G = 0.00222, 9.81
LIGHT = 1e-6


@pytest.fixture
def world(engine: str) -> Iterator[World]:
    made = World(engine, DT)
    made.set_gravity((0, 0, 0))
    yield made
    made.close()


def crate(world: World) -> RigidBody:
    """2 kg, its centre of mass off the origin, its principal axes askew, turned in the world."""
    body = world.add_body([Shape("box", (0.1, 0.1, 0.1))], 2.0, INERTIA, COM)
    body.set_state((1, 2, 3), wxyz(TURN))
    return body


def com_velocity(body: RigidBody) -> Array:
    return body.linear_velocity + np.cross(body.angular_velocity, body.rotation @ COM)


def test_a_force_at_the_centre_of_mass_acts_for_one_substep(world: World) -> None:
    body, force = crate(world), np.array([3.0, -4.0, 5.0])
    body.set_external_force(force)
    body.set_external_force(force)
    world.integrate(13)
    assert com_velocity(body) == pytest.approx(2 * force * DT / 2.0, abs=1e-12)
    assert body.angular_velocity == pytest.approx([0, 0, 0], abs=1e-12)
    world.integrate(13)
    assert com_velocity(body) == pytest.approx(force * DT, abs=1e-12)


@pytest.mark.parametrize("how", ["torque", "force off the centre"])
def test_torque_turns_by_the_inertia(world: World, how: str) -> None:
    body, R = crate(world), TURN.as_matrix()
    if how == "torque":
        torque = np.array([0.02, 0.01, -0.03])
        body.set_external_torque(torque)
        moved = np.zeros(3)
    else:
        at, force = np.array([0.05, 0.05, -0.05]), np.array([0.3, 0.2, -0.1])
        body.set_external_force(force, at)
        torque = np.cross(R @ (at - COM), force)
        moved = force * DT / 2.0
    world.integrate(1)
    assert body.angular_velocity == pytest.approx(R @ np.linalg.solve(INERTIA, R.T @ torque) * DT, rel=1e-6, abs=1e-9)
    assert com_velocity(body) == pytest.approx(moved, abs=1e-9)


def test_forces_on_static_bodies_do_nothing(world: World) -> None:
    wall = world.add_body([Shape("box", (1, 1, 1))], 0.0, np.eye(3))
    wall.set_external_force((0, 0, 100))
    wall.set_external_torque((0, 0, 100))
    world.integrate(5)
    assert wall.position.tolist() == [0, 0, 0]
    assert wall.kinetic_energy == 0.0 and wall.linear_momentum.tolist() == [0, 0, 0]
    assert wall.angular_momentum().tolist() == [0, 0, 0]


def test_what_is_no_vector_is_refused(world: World, tmp_path: Path) -> None:
    body, arm = crate(world), world.add_articulated_system(read(tmp_path, ARM))
    calls: list[Callable[[], None]] = [
        lambda: body.set_external_force((0, np.nan, 0)),
        lambda: body.set_external_force((0, 0, 1), (0, 0)),
        lambda: body.set_external_torque(1.0),
        lambda: arm.set_external_force("tool", (1, 2)),
        lambda: arm.set_external_torque("tool", (np.inf, 0, 0)),
        lambda: world.set_gravity((0, 0)),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="expected 3 finite numbers"):
            call()
    with pytest.raises(ValueError, match="no link 'finger'"):
        arm.set_external_force("finger", (0, 0, 1))


def test_a_force_on_a_link_is_felt_by_the_implicit_law(world: World, tmp_path: Path) -> None:
    """One joint about y; a force F at arm r turns it by dt (r x F) / (J + dt D + dt^2 K) in the one substep."""
    system = world.add_articulated_system(write_chain(tmp_path / "arm.urdf", mass=0.3, length=0.2))
    system.set_pd_gains(50, 0.2)
    system.set_external_force("link0", (0, 0, -2.0))
    system.set_external_force("link0", (0, 7.0, -1.0), (0.1, 0, 0))
    system.set_external_torque("link0", (5.0, 0.3, 5.0))
    world.integrate(1)
    moment = 2.0 * 0.2 + 1.0 * 0.1 + 0.3
    inertia = 0.3 * 0.2**2 + LIGHT + DT * (0.2 + 0.5) + DT**2 * 50
    first = system.generalized_velocity[0]
    assert first == pytest.approx(moment * DT / inertia, rel=1e-9)
    world.integrate(1)
    assert abs(system.generalized_velocity[0]) < first


def test_a_steady_force_on_a_fingertip_bends_the_joints_by_its_moments(world: World) -> None:
    hand = world.add_articulated_system(URDF_PATH)
    hand.set_base_pose((0.1, 0.2, 0.3), wxyz(TURN))
    hand.set_pd_gains(50, 0.2)
    tip, force = hand.frame_names[-1], np.array([0.4, -0.3, 0.5])
    for _ in range(400):
        hand.set_external_force(tip, force, (0, 0, 0))
        world.integrate(1)
    linear, _ = hand.frame_jacobian(tip)
    assert hand.generalized_coordinate[3:] * 50 == pytest.approx((linear.T @ force)[3:], abs=2e-4)
    assert np.abs(linear.T @ force)[3:].max() > 0.02


def test_frame_velocities_are_what_frames_do(world: World, tmp_path: Path) -> None:
    arm = world.add_articulated_system(read(tmp_path, ARM))
    arm.set_base_pose((0.1, 0.2, 0.3), wxyz(TURN))
    q, v, eps = np.array([0.7, 0.4, -1.1]), np.array([0.3, -2.0, 1.5]), 1e-3
    for frame in ("arm", "tool", "mark", "side"):
        poses = []
        for sign in (-1, 1):
            arm.set_state(q + sign * eps * v)
            poses.append(arm.frame_pose(frame))
        arm.set_state(q, v)
        linear, angular = arm.frame_velocity(frame)
        assert linear == pytest.approx((poses[1][1] - poses[0][1]) / (2 * eps), abs=1e-3)
        turned = Rotation.from_matrix(poses[1][0] @ poses[0][0].T).as_rotvec()
        assert angular == pytest.approx(turned / (2 * eps), abs=1e-3)


def moving_hand(world: World) -> tuple[ArticulatedSystem, Array, Array]:
    hand = world.add_articulated_system(URDF_PATH)
    hand.set_base_pose((0.1, 0.2, 0.3), wxyz(TURN))
    rng = np.random.default_rng(4)
    q, v = rng.uniform(-0.4, 0.4, 51), rng.uniform(-1, 1, 51)
    hand.set_state(q, v)
    return hand, q, v


def test_a_system_s_energy_is_that_of_its_links(world: World) -> None:
    hand, q, v = moving_hand(world)
    # The textbook's matrix for spheres of the mean inertia; the tolerance covers the difference to the true ones.
    mean = np.array([np.trace(link.inertia) / 3 for link in hand.model.links])
    energy = v @ mass_matrix(hand.model, q, mean) @ v / 2
    assert hand.kinetic_energy == pytest.approx(energy, rel=2e-3)
    world.set_gravity((1.0, 2.0, -9.81))
    assert hand.potential_energy == pytest.approx(-hand.mass * np.array([1.0, 2.0, -9.81]) @ hand.center_of_mass)
    assert hand.mass == pytest.approx(hand.model.mass)


def test_a_system_s_momentum_is_its_mass_times_the_speed_of_its_centre(world: World) -> None:
    hand, q, v = moving_hand(world)
    momentum, eps, centers = hand.linear_momentum, 1e-3, []
    for sign in (-1, 1):
        hand.set_state(q + sign * eps * v)
        centers.append(hand.center_of_mass)
    assert momentum == pytest.approx(hand.mass * (centers[1] - centers[0]) / (2 * eps), abs=1e-3)
    assert np.linalg.norm(momentum) > 0.1


def test_angular_momentum_of_one_link_by_hand(world: World, tmp_path: Path) -> None:
    """A point mass at the end of an arm about y: L = m l^2 w about the joint, and (t - p) x m v is added about p."""
    system = world.add_articulated_system(write_chain(tmp_path / "arm.urdf", mass=0.3, length=0.2))
    system.set_base_pose((1, 0, 0))
    system.set_state([0.0], [3.0])
    assert system.angular_momentum((1, 0, 0)) == pytest.approx([0, 0.3 * 0.04 * 3.0, 0], abs=1e-8)
    # The mass is at (1.2, 0, 0) and moves down with 0.6 m/s.
    assert system.linear_momentum == pytest.approx([0, 0, -0.18], abs=1e-7)
    assert system.angular_momentum() == pytest.approx([0, 1.2 * 0.18, 0], abs=1e-7)
    assert system.kinetic_energy == pytest.approx(0.3 * 0.36 / 2, abs=1e-7)
    assert system.center_of_mass == pytest.approx([1.2, 0, 0], abs=1e-7)


def test_a_thrown_body_keeps_its_momenta_and_its_energy(world: World) -> None:
    world.set_gravity((0, 0, -G))
    body = crate(world)
    body.set_state((1, 2, 3), wxyz(TURN), (1, 0, 2), (2, -1, 0.5))
    total = body.kinetic_energy + body.potential_energy
    spin = body.angular_momentum(body.center_of_mass)
    expected = 2.0 * com_velocity(body) @ com_velocity(body) / 2 + spin @ body.angular_velocity / 2
    assert body.kinetic_energy == pytest.approx(expected)
    assert body.potential_energy == pytest.approx(2.0 * G * body.center_of_mass[2])
    momentum = body.linear_momentum
    world.integrate(100)
    assert body.linear_momentum == pytest.approx(momentum - [0, 0, 2.0 * G * 100 * DT], abs=1e-9)
    assert np.linalg.norm(body.angular_momentum(body.center_of_mass) - spin) < 0.01 * np.linalg.norm(spin)
    # Semi-implicit Euler loses m g^2 dt t / 2 of the potential energy.
    lost = 2.0 * G**2 * DT * 100 * DT / 2
    assert body.kinetic_energy + body.potential_energy == pytest.approx(total - lost, abs=2e-4)
    about = body.angular_momentum((3.0, 0, 0))
    arm = body.center_of_mass - [3.0, 0, 0]
    assert about - np.cross(arm, body.linear_momentum) == pytest.approx(body.angular_momentum(body.center_of_mass))


def test_contacts_give_their_impulses_in_the_world(world: World) -> None:
    world.set_gravity((0, 0, -G))
    world.add_ground()
    box = world.add_box(0.2, 0.2, 0.1, 1.2)
    box.set_state((0, 0, 0.05))
    world.integrate(200)
    contacts = box.contacts()
    assert sum(c.impulse_W for c in contacts) == pytest.approx([0, 0, 1.2 * G * DT], abs=1e-5)
    assert contacts[0].impulse_W == pytest.approx(
        contacts[0].impulse * contacts[0].normal_W + contacts[0].tangential_impulse_W
    )


def test_names_and_state_vectors(world: World, tmp_path: Path) -> None:
    arm, ball = world.add_articulated_system(read(tmp_path, ARM)), world.add_sphere(0.1, 1.0)
    assert arm.name == arm.model.name and world.get_object(arm.name) is arm
    ball.name = "ball"
    assert world.get_object("ball") is ball and world.objects == [arm, ball]
    assert arm.joint_names == arm.model.joint_names and len(arm.body_names) == arm.dof
    assert set(arm.body_names) < set(arm.frame_names)
    arm.set_state([0.1, 0.2, 0.3], [1, 2, 3])
    assert [part.tolist() for part in arm.state] == [[0.1, 0.2, 0.3], [1, 2, 3]]
    world.set_gravity((0, 1, -2))
    assert world.gravity.tolist() == [0, 1, -2]
    world.gravity[:] = 5.0
    assert world.gravity.tolist() == [0, 1, -2]
    world.remove(ball)
    with pytest.raises(ValueError, match=r"no object is named 'ball'; there are \["):
        world.get_object("ball")
