"""Mechanics on MuJoCo Warp, through the interface to engines, on the device that Warp finds.

The device computes in single precision: an accuracy of 1e-4 m and m/s is expected where other engines reach 1e-9. The
first run on a machine compiles the kernels, for about a minute.
"""

from __future__ import annotations

import numpy as np
import pytest

from raisim_like import Shape, UrdfModel
from raisim_like.batch import BatchState, BodySpec, Preset, WorldSpec
from raisim_like.material import MaterialTable
from raisim_like.registry import make_batch
from raisim_like.rotations import matrix_from_rotation_vector, quaternion_from_matrix
from raisim_like.world import BODY, STATIC, collision_mask
from tests.raisim_like.warp_worlds import (
    ANY,
    ARM,
    DT,
    FIRST,
    FRICTION,
    GROUND,
    HIGH,
    LOW,
    PLATE,
    SECOND,
    G,
    Start,
    advance,
    make,
    read_machine,
    tilted,
    world_spec,
)  # fmt: skip

pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed: pip install 'dgrasp[warp]'")


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> UrdfModel:
    return read_machine(tmp_path_factory.mktemp("warp"))


@pytest.mark.parametrize("preset", ["faithful", "fast"])
def test_a_body_falls_freely(machine: UrdfModel, preset: Preset) -> None:
    """13 timesteps are 7 steps of the preset "fast"; each step changes the velocity first."""
    batch = make([world_spec(machine, preset=preset)], [Start({LOW: [0, 0, 5, 1, 0, 0, 0, 0.3, 0, 1, 0, 0, 4]})])
    advance(batch, 10, 13)
    n, dt = (130, DT) if preset == "faithful" else (70, 13 * DT / 7)
    height = 5 + n * dt - G * dt**2 * n * (n + 1) / 2
    state = batch.state.bodies[0, LOW]
    assert state[:3] == pytest.approx([0.3 * n * dt, 0, height], abs=1e-4)
    assert state[7:] == pytest.approx([0.3, 0, 1 - G * n * dt, 0, 0, 4], abs=1e-4)
    assert state[3:7] == pytest.approx([np.cos(2 * n * dt), 0, 0, np.sin(2 * n * dt)], abs=1e-4)
    batch.close()


def test_a_block_holds_below_the_friction_angle_and_slides_above(machine: UrdfModel) -> None:
    tangents = (0.97 * FRICTION, 1.2 * FRICTION)
    planes = [tilted(tangent) for tangent in tangents]
    batch = make([world_spec(machine)] * 2, [start for _, start in planes])
    advance(batch, 400)
    (held, _), (slid, _) = planes
    along = held.T @ batch.state.bodies[0, LOW, :3]
    assert np.abs(along[:2]).max() < 2e-4 and np.abs(batch.state.bodies[0, LOW, 7:10]).max() < 1e-4
    angle = np.arctan(tangents[1])
    expected = G * (np.sin(angle) - FRICTION * np.cos(angle))
    assert (slid.T @ batch.state.bodies[1, LOW, 7:10])[0] / (400 * DT) == pytest.approx(expected, rel=0.02)
    batch.close()


def test_a_sliding_block_stays_on_the_ground_and_stops_after_its_braking_distance(machine: UrdfModel) -> None:
    """Without the correction of sliding contacts, the block would lift off at 0.6 m/s."""
    batch = make([world_spec(machine)], [Start({LOW: [0, 0, 0.03, 1, 0, 0, 0, 1.5]})])
    heights, touching, pressed = [], np.zeros(1), []
    for _ in range(300):
        advance(batch, 1)
        batch.touching([0], LOW, GROUND, touching)
        heights.append(batch.state.bodies[0, LOW, 2])
        pressed.append(touching[0])
    # The cost of the correction: the block sinks in by friction * timestep * speed.
    assert min(heights) > 0.03 - FRICTION * DT * 1.5 - 2e-4 and max(heights) < 0.03 + 1e-4
    assert all(pressed[3:])
    # It needs v / (mu g) = 0.3058 s, 138 steps.
    assert batch.state.bodies[0, LOW, 0] == pytest.approx(1.5**2 / (2 * FRICTION * G), rel=0.01)
    assert np.abs(batch.state.bodies[0, LOW, 7:10]).max() < 1e-4
    batch.close()


@pytest.mark.parametrize("preset", ["faithful", "fast"])
def test_a_plate_bears_the_weight_of_a_stack(machine: UrdfModel, preset: Preset) -> None:
    """Worlds that differ in a mass are one group; impulses are those of one timestep with both presets."""
    start = Start({LOW: [0, 15, 0.08, 1], HIGH: [0, 15, 0.14, 1]})
    masses = (1.0, 3.0)
    batch = make([world_spec(machine, preset=preset, mass=mass) for mass in masses], [start, start])
    assert len(batch.groups) == 1  # type: ignore[attr-defined]
    advance(batch, 60, 13)
    impulse, touching = np.full((2, 2), np.nan), np.full(2, np.nan)
    batch.link_impulses(range(2), LOW, impulse)
    for i, mass in enumerate(masses):
        assert impulse[i] == pytest.approx([(mass + 2.0) * G * DT, 0.0], rel=2e-3)
        # The plate weighs 1 kg; its spring yields by the force over the stiffness.
        assert batch.state.gc[i, PLATE] == pytest.approx(-(mass + 3.0) * G / 5000.0, rel=2e-3)
    batch.link_impulses(range(2), HIGH, impulse)
    assert not impulse.any()
    batch.touching(range(2), LOW, HIGH, touching)
    assert touching.tolist() == [1.0, 1.0]
    batch.touching(range(2), GROUND, LOW, touching)
    assert touching.tolist() == [0.0, 0.0]
    batch.close()


def test_a_joint_yields_by_its_torque_over_its_stiffness(machine: UrdfModel) -> None:
    """The worlds of a group have gains and forces of their own."""
    kp, force = np.array([[5000.0, 20.0], [5000.0, 80.0]]), np.array([[0.0, 0.0], [0.0, 1.5]])
    batch = make([world_spec(machine)] * 2, [Start(), Start()])
    batch.set_gains(range(2), kp, np.full((2, 2), 0.2), force)
    advance(batch, 60, 13)
    for i in range(2):
        q = batch.state.gc[i, ARM]
        assert kp[i, 1] * q == pytest.approx(0.3 * G * 0.2 * np.cos(q) + force[i, 1], abs=1e-3)
    batch.close()


def test_the_constants_of_contacts_follow_the_gains_and_masses_of_each_world(machine: UrdfModel) -> None:
    """They are those that C MuJoCo derives for one world alone, to single precision."""
    kp = np.array([[5000.0, 20.0], [800.0, 80.0]])
    here, there = (
        make([world_spec(machine, mass=mass) for mass in (1.0, 3.0)], [Start(), Start()], engine)
        for engine in ("warp", "mujoco")
    )
    for batch in (here, there):
        batch.set_gains(range(2), kp, np.full((2, 2), 0.2), np.zeros((2, 2)))
        advance(batch, 1)
    (group,) = here.groups  # type: ignore[attr-defined]
    for name in ("body_mass", "body_invweight0", "dof_invweight0", "dof_armature", "dof_damping", "jnt_stiffness"):
        values, part = getattr(group.model, name).numpy(), {"b": "bodies", "d": "v", "j": "joints"}[name[0]]
        for i, world in enumerate(there.worlds):  # type: ignore[attr-defined]
            alone = world.engine_world._built
            # The bodies have the same numbers in both, but stand in another order.
            for body, slot in group.built.slots.items():
                expected = getattr(alone.model, name)[getattr(alone.slots[body], part)]
                assert values[i][getattr(slot, part)] == pytest.approx(expected, rel=1e-5), name
        assert (values[0] != values[1]).any()
    for batch in (here, there):
        batch.close()


@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_collisions_keep_momentum_and_lose_the_normal_velocity(machine: UrdfModel, offset: float) -> None:
    start = Start({FIRST: [0, 0, 3, 1, 0, 0, 0, 1], SECOND: [0.3, offset, 3, 1, 0, 0, 0, -0.2]})
    batch = make([world_spec(machine, gravity=0.0)], [start])
    advance(batch, 150)
    first, second = batch.state.bodies[0, FIRST, 7:10], batch.state.bodies[0, SECOND, 7:10]
    assert 1.0 * first + 2.5 * second == pytest.approx([0.5, 0, 0], abs=1e-5)
    if offset == 0.0:
        assert [first[0], second[0]] == pytest.approx([0.5 / 3.5] * 2, abs=1e-4)
    else:
        assert second[1] > 0.01 > -0.01 > first[1]
    batch.close()


@pytest.mark.parametrize("slope", [0.0, 8.0])
def test_cylinders_on_a_table_stay_and_roll_down_a_slope(slope: float) -> None:
    """They stay within 1 mm for 5 s; on a slope (degrees) they gain 2/3 g sin a. Worlds without systems."""
    radius, length, mass, n = 0.0335, 0.1, 0.35, 4
    side, a = mass * (3 * radius**2 + length**2) / 12, np.radians(slope)
    can = BodySpec((Shape("cylinder", (radius, length)),), mass, np.diag([side, side, mass * radius**2 / 2]),
                   np.zeros(3), "any", collision_mask(BODY, ANY))  # fmt: skip
    table = BodySpec((Shape("box", (1.2, 1.2, 1.0)),), 0.0, np.eye(3), np.zeros(3), "any", collision_mask(STATIC, ANY))
    spec = WorldSpec((), (can, table), DT, gravity=(G * np.sin(a), 0.0, -G * np.cos(a)), materials=MaterialTable(0.8))
    batch = make_batch("warp", [spec] * n, BatchState(np.zeros((n, 0)), np.zeros((n, 0)), np.zeros((n, 2, 13))))
    bodies = np.zeros((n, 2, 13))
    bodies[:, :, 3], bodies[:, 1, 2] = 1.0, -0.5
    for k in range(n):
        about = matrix_from_rotation_vector(np.array([0.0, 0.0, 0.0 if slope else 0.7 * k]))
        lying = about @ matrix_from_rotation_vector(np.array([np.pi / 2, 0.0, 0.0]))
        bodies[k, 0, :3] = [-0.4 if slope else 0.02 * k, 0.01 * k, radius]
        bodies[k, 0, 3:7] = quaternion_from_matrix(lying)
    batch.place(range(n), np.zeros((n, 0, 7)), np.zeros((n, 0)), bodies)
    steps = 230 if slope else 2250
    for _ in range(steps // 10):
        batch.advance(range(n), np.zeros((n, 0)), 10)
    moved = batch.state.bodies[:, 0]
    if slope:
        assert moved[:, 7] == pytest.approx(np.full(n, 2 / 3 * G * np.sin(a) * steps * DT), rel=0.02)
        assert moved[:, 2] == pytest.approx(np.full(n, radius), abs=2e-4)
    else:
        assert np.linalg.norm(moved[:, :3] - bodies[:, 0, :3], axis=1).max() < 1e-3
    batch.close()
