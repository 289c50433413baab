"""PD control against RaiSim's implicit law and against statics, for a joint that is free or loaded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dgrasp.hand.free.hand import URDF_PATH
from dgrasp.types import Array
from raisim_like import ArticulatedSystem, Shape, World, read_urdf
from raisim_like.engines.floors import LIGHT_INERTIA
from tests.engines import needs_pybullet
from tests.raisim_like.urdfs import mass_matrix, write_chain

DT, G = 0.00222, 9.81
KP, KD = 50.0, 0.2


@pytest.fixture
def world(engine: str) -> Iterator[World]:
    made = World(engine, DT)
    made.set_gravity((0, 0, 0))
    yield made
    made.close()


@pytest.fixture(scope="module")
def hand_model():
    return read_urdf(URDF_PATH)


def add(world: World, urdf: object, kp: float = KP, kd: float = KD) -> ArticulatedSystem:
    system = world.add_articulated_system(urdf)  # type: ignore[arg-type]
    system.set_pd_gains(kp, kd)
    return system


def light_mass_matrix(system: ArticulatedSystem, q: Array) -> Array:
    return mass_matrix(system.model, q, np.full(system.dof, LIGHT_INERTIA))


def implicit_steps(
    system: ArticulatedSystem, q: Array, target: Array, force: Array, control_steps: int
) -> Iterator[tuple[Array, Array]]:
    """RaiSim's law on the light system: (M + dt D + dt^2 K) v+ = M v + dt (K (q* - q) + ff), M once per 13 substeps."""
    K, D = np.full(system.dof, KP), KD + system.model.joint_damping
    v = np.zeros(system.dof)
    for _ in range(control_steps):
        M = light_mass_matrix(system, q)
        for _ in range(13):
            v = np.linalg.solve(M + np.diag(DT * D + DT**2 * K), M @ v + DT * (K * (target - q) + force))
            q = q + DT * v
        yield q, v


def bent(model: object, rng: np.random.Generator, share: float) -> Array:
    """Coordinates with the fingers somewhere in the middle `share` of their range; the wrist at zero."""
    low, high = model.joint_limits.T  # type: ignore[attr-defined]
    q = (low + high) / 2 + share * (high - low) / 2 * rng.uniform(-1, 1, len(low))
    q[:6] = 0.0
    return q


@pytest.mark.parametrize("engine", ["pybullet"], indirect=True)
def test_one_joint_is_the_implicit_law_exactly(world: World, tmp_path: Path) -> None:
    system = add(world, write_chain(tmp_path / "arm.urdf"))
    target, force = np.array([0.7]), np.array([4.0])
    system.set_pd_target(target)
    system.set_generalized_force(force)
    for q, v in implicit_steps(system, np.zeros(1), target, force, 12):
        world.integrate(13)
        assert system.generalized_coordinate == pytest.approx(q, abs=1e-11)
        assert system.generalized_velocity == pytest.approx(v, abs=1e-9)


@needs_pybullet
def test_blocks_of_the_fast_preset_end_with_the_implicit_law_s_velocity(tmp_path: Path) -> None:
    """v at the end of a block is what the law gives for the block's start, and v changes linearly up to there."""
    world = World("pybullet", DT, "fast")
    world.set_gravity((0, 0, 0))
    system = add(world, write_chain(tmp_path / "arm.urdf"))
    target, force = np.array([0.7]), np.array([4.0])
    system.set_pd_target(target)
    system.set_generalized_force(force)
    M, D = light_mass_matrix(system, np.zeros(1))[0], KD + system.model.joint_damping
    q, v = np.zeros(1), np.zeros(1)
    dt = 13 * DT / 7
    for _ in range(12):
        world.integrate(13)
        for m in (2, 2, 2, 1):
            x, end = q, v
            for _ in range(m):
                end = (M * end + dt * (KP * (target - x) + force)) / (M + dt * D + dt**2 * KP)
                x = x + dt * end
            q = q + dt * sum(v + (end - v) * j / m for j in range(1, m + 1))
            v = end
        assert system.generalized_coordinate == pytest.approx(q, abs=1e-11)
        assert system.generalized_velocity == pytest.approx(v, abs=1e-9)
    # It comes to rest where kp (q* - q) + ff = 0.
    assert q == pytest.approx(target + force / KP, abs=1e-3)
    world.close()


@needs_pybullet
def test_the_fast_preset_reports_the_impulse_of_a_substep_too() -> None:
    world = World("pybullet", DT, "fast")
    ground, box = world.add_ground(), world.add_box(0.1, 0.1, 0.1, 2.0)
    box.set_state((0, 0, 0.05))
    world.integrate(13 * 20)
    impulse = sum(contact.impulse for contact in box.contacts())
    assert ground.id != box.id and impulse == pytest.approx(2.0 * G * DT, rel=1e-6)
    world.close()


@needs_pybullet
def test_blocks_add_up_and_divide_without_remainder() -> None:
    from raisim_like.engines.bullet import pd as bullet_pd

    for timestep in (0.00222, 0.001, 0.005, 1 / 240, 0.0033):
        for substeps in (1, 6, 13, 300):
            lengths = bullet_pd.blocks(substeps, timestep, 4)
            assert sum(lengths) == substeps and max(lengths) <= 4
            assert all(m * timestep / m == timestep and int(m * timestep / timestep) == m for m in set(lengths))


@needs_pybullet
@pytest.mark.parametrize("branches", [None, (6, 9)])
def test_the_inverse_of_a_tree_s_mass_matrix(hand_model: object, branches: tuple[int, int] | None) -> None:
    from raisim_like.engines.bullet import mass as bullet_mass

    assert bullet_mass.axes_of(hand_model).branches == (6, 9)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    M = np.zeros((3, 51, 51))
    for a in M:
        for f in range(5):
            rows = np.r_[0:6, 6 + 9 * f : 15 + 9 * f]
            half = rng.normal(size=(15, 15))
            a[np.ix_(rows, rows)] += half @ half.T + np.eye(15)
    assert np.abs(bullet_mass.inverse(M, branches) @ M - np.eye(51)).max() < 1e-10


@pytest.mark.parametrize("joints", [1, 3])
def test_a_constant_torque_deflects_by_tau_over_kp(world: World, tmp_path: Path, joints: int) -> None:
    system = add(world, write_chain(tmp_path / "arm.urdf", joints, mass=0.05, length=0.1))
    tau = np.array([5.0, -2.0, 1.0])[:joints]
    system.set_generalized_force(tau)
    world.integrate(600)
    assert system.generalized_coordinate == pytest.approx(tau / KP, abs=1e-9)


def test_gravity_bends_a_pendulum_by_its_moment(world: World, tmp_path: Path) -> None:
    world.set_gravity((0, 0, -G))
    system = add(world, write_chain(tmp_path / "arm.urdf", mass=0.3, length=0.2), kp=5.0)
    system.set_pd_target([-0.4])
    world.integrate(1500)
    # About y, a positive angle lowers the arm: gravity's moment is m g l cos q.
    q = system.generalized_coordinate[0]
    assert 5.0 * (q + 0.4) == pytest.approx(0.3 * G * 0.2 * np.cos(q), abs=1e-9)
    assert q > -0.4


def test_every_joint_of_a_hand_deflects_by_tau_over_kp(world: World, hand_model: object) -> None:
    system = add(world, hand_model)
    rng = np.random.default_rng(3)
    target = bent(hand_model, rng, 0.3)
    tau = 0.02 * KP * rng.uniform(-1, 1, system.dof)
    system.set_state(target)
    system.set_pd_target(target)
    system.set_generalized_force(tau)
    world.integrate(13 * 35)
    assert system.generalized_coordinate[3:] == pytest.approx((target + tau / KP)[3:], abs=1e-6)
    # The translations have D = 10.2: their time constant D / kp is 0.2 s, five of which have passed.
    assert system.generalized_coordinate[:3] == pytest.approx(tau[:3] / KP, abs=2e-4)


def test_a_free_hand_moves_by_the_implicit_law(world: World, hand_model: object) -> None:
    system = add(world, hand_model)
    rng = np.random.default_rng(0)
    q, force = bent(hand_model, rng, 0.3), np.zeros(system.dof)
    target = q + 0.25 * (bent(hand_model, rng, 0.9) - q)
    target[:3], target[3:6] = 0.03 * rng.uniform(-1, 1, 3), 0.1 * rng.uniform(-1, 1, 3)
    system.set_state(q)
    system.set_pd_target(target)
    errors = []
    for expected, _ in implicit_steps(system, q, target, force, 15):
        world.integrate(13)
        errors.append(np.abs(system.generalized_coordinate - expected))
    # Centrifugal forces reach the law through its observer, so there is a difference while the joints move.
    assert np.max(errors) < 2e-3
    assert np.max(errors[-1][3:]) < 5e-5
    assert np.abs(target - q)[6:].max() > 0.15


@needs_pybullet
def test_a_free_hand_is_a_substep_or_so_late_with_the_fast_preset(hand_model: object) -> None:
    world = World("pybullet", DT, "fast")
    world.set_gravity((0, 0, 0))
    system = add(world, hand_model)
    rng = np.random.default_rng(0)
    q = bent(hand_model, rng, 0.3)
    target = q + 0.25 * (bent(hand_model, rng, 0.9) - q)
    system.set_state(q)
    system.set_pd_target(target)
    errors = []
    for expected, _ in implicit_steps(system, q, target, np.zeros(51), 15):
        world.integrate(13)
        errors.append(np.abs(system.generalized_coordinate - expected).max())
    # After the target jumps by up to 0.28 rad, the velocity changes linearly within a block.
    assert errors[0] < 0.02 and max(errors[1:]) < 8e-3 and max(errors[3:]) < 2e-3
    world.close()


def test_a_load_is_felt_by_the_light_arm_not_by_the_simulated_one(world: World, tmp_path: Path) -> None:
    """Without gains and damping only gravity acts, and the observer makes up for the inflated inertia."""
    world.set_gravity((0, 0, -G / 10))
    m, length = 0.01, 0.05
    system = add(world, write_chain(tmp_path / "arm.urdf", mass=m, length=length, damping=0.0), kp=0.0, kd=0.0)
    world.integrate(70)
    v, q = system.generalized_velocity[0], system.generalized_coordinate[0]
    world.integrate(10)
    acceleration = (system.generalized_velocity[0] - v) / (10 * DT)
    middle = (q + system.generalized_coordinate[0]) / 2
    moment = m * G / 10 * length * np.cos(middle)
    assert acceleration == pytest.approx(moment / (m * length**2 + LIGHT_INERTIA), rel=0.02)
    if world.engine.name == "pybullet":
        assert system.mass_matrix()[0, 0] > 30 * m * length**2
    else:
        assert system.mass_matrix()[0, 0] == pytest.approx(m * length**2 + LIGHT_INERTIA)


def test_a_grip_presses_with_the_whole_motor_torque(world: World, tmp_path: Path) -> None:
    system = add(world, write_chain(tmp_path / "arm.urdf", tip_radius=0.02))
    wall = world.add_body([Shape("box", (0.2, 0.2, 0.2))], 0.0, np.eye(3))
    wall.set_state((0.2, 0, -0.13))
    system.set_pd_target([0.3])
    system.set_generalized_force([1.0])
    world.integrate(150)
    q = system.generalized_coordinate[0]
    contacts = system.contacts()
    # PyBullet's forces act on each body's own surface, MuJoCo's halfway between the two.
    share = 0.0 if world.engine.name == "pybullet" else 0.5
    moment = sum(
        float(np.cross(c.point_W - share * c.depth * c.normal_W, c.impulse * c.normal_W + c.tangential_impulse_W)[1])
        for c in contacts
    ) / DT
    assert q < 0.1
    # MuJoCo's contact is a ten-thousandth soft, so the joint still moves, against its damping.
    assert moment == pytest.approx(-(KP * (0.3 - q) + 1.0), abs=1e-6 if world.engine.name == "pybullet" else 1e-3)
    assert {(c.body_a, c.link_a, c.body_b, c.link_b) for c in contacts} == {(system.id, 0, wall.id, -1)}
    impulses = np.full(1, np.nan)
    world.engine_world.link_impulses(system.id, wall.id, impulses)
    assert impulses[0] == pytest.approx(sum(c.impulse for c in contacts), abs=1e-15)


def test_a_new_state_forgets_the_load(world: World, tmp_path: Path) -> None:
    world.set_gravity((0, 0, -G))
    path = write_chain(tmp_path / "arm.urdf", 2)
    runs = []
    system = add(world, path)
    for _ in range(2):
        system.set_state([0.3, -0.2])
        world.integrate(40)
        runs.append(system.generalized_coordinate)
    assert runs[0].tolist() == runs[1].tolist()


@pytest.mark.parametrize("engine", ["pybullet"], indirect=True)
def test_inflated_minus_light_is_the_added_inertia(world: World, hand_model: object) -> None:
    """Mb - Mr from joint axes, against mass matrices from the links' Jacobians, and Bullet's own."""
    from raisim_like.engines.bullet import pd as bullet_pd
    from raisim_like.engines.bullet.urdf import simulated_inertias

    system = add(world, hand_model)
    rng = np.random.default_rng(8)
    q = np.array([bent(hand_model, rng, 0.9) for _ in range(3)])
    q[:, 3:6] = rng.uniform(-1, 1, (3, 3))
    added = bullet_pd.ImplicitPd(world.engine_world.client, system.id, system.model, DT).axes.added_inertia(q)
    for i in range(3):
        system.set_state(q[i])
        heavy = mass_matrix(system.model, q[i], simulated_inertias(system.model))
        assert np.abs(system.mass_matrix() - heavy).max() < 1e-12
        assert np.abs(heavy - added[i] - light_mass_matrix(system, q[i])).max() < 1e-12
    assert np.abs(added).max() > 1e-3
