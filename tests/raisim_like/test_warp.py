"""MuJoCo Warp through the interface to engines, on the device that Warp finds: mechanics, groups, rows, broken worlds.

The device computes in single precision: an accuracy of 1e-4 m and m/s is expected where other engines reach 1e-9. The
first run on a machine compiles the kernels, for about a minute.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgrasp.pool import make_pool
from raisim_like import EngineError, Shape, UrdfModel, read_urdf
from raisim_like.batch import Array, BatchState, BodySpec, Preset, SystemSpec, WorldBatch, WorldSpec
from raisim_like.material import MaterialTable
from raisim_like.registry import find_engine, make_batch
from raisim_like.rotations import matrix_from_rotation_vector, quaternion_from_matrix
from raisim_like.world import BODY, STATIC, SYSTEM, collision_mask
from tests.scenes import make_spec

pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed: pip install 'dgrasp[warp]'")

DT, G, FRICTION = 0.00222, 9.81, 0.5
GROUND, LOW, HIGH, FIRST, SECOND = range(5)
PLATE, ARM = range(2)
ANY = STATIC | BODY | SYSTEM
MACHINE = """
<robot name="machine"><link name="base"/>
<link name="plate"><inertial><mass value="1"/></inertial>
  <collision><geometry><box size="1 1 0.1"/></geometry></collision></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="plate"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1"/></joint>
<link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="0.3"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="2 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3"/><dynamics damping="0.5"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> UrdfModel:
    """A plate that moves up and down, and a weight of 0.3 kg on an arm of 0.2 m that turns about y."""
    path = tmp_path_factory.mktemp("warp") / "machine.urdf"
    path.write_text(MACHINE, encoding="utf-8")
    return read_urdf(path)


def world_spec(
    machine: UrdfModel, gravity: float = G, preset: Preset = "faithful", mass: float = 1.0, height: float = 0.06
) -> WorldSpec:
    """The machine, the ground, two blocks of `mass` and 2 kg, and two balls of 1 and 2.5 kg."""

    def body(shape: Shape, kg: float, moment: float) -> BodySpec:
        mask = collision_mask(BODY if kg else STATIC, ANY)
        return BodySpec((shape,), kg, moment * np.eye(3), np.zeros(3), "any", mask)

    block, ball = Shape("box", (0.3, 0.3, height)), Shape("sphere", (0.05,))
    bodies = (
        body(Shape("box", (4.0, 4.0, 1.0)), 0.0, 1.0), body(block, mass, 0.008 * mass), body(block, 2.0, 0.016),
        body(ball, 1.0, 0.4 * 0.05**2), body(ball, 2.5, 2.5 * 0.4 * 0.05**2),
    )  # fmt: skip
    system = SystemSpec(machine, "any", collision_mask(SYSTEM, ANY), enforce_limits=False)
    return WorldSpec((system,), bodies, DT, preset, (0.0, 0.0, -gravity), MaterialTable(FRICTION))


class Start:
    """Where everything is at first: out of each other's way, except for what `states` says by body."""

    def __init__(self, states: dict[int, Sequence[float]] | None = None) -> None:
        self.bodies = np.zeros((5, 13))
        self.bodies[:, 0], self.bodies[:, 2:4] = [0, 3, 4, 5, 6], [7.0, 1.0]
        self.bodies[GROUND, 2] = -0.5
        for body, state in (states or {}).items():
            self.bodies[body, : len(state)] = state
        self.base = np.array([[0.0, 15.0, 0.0, 1.0, 0.0, 0.0, 0.0]])


def begin(batch: WorldBatch, rows: Sequence[int], starts: Sequence[Start], kp: float = 5000.0) -> None:
    """Place worlds and set their gains."""
    n = len(rows)
    batch.place(rows, np.array([s.base for s in starts]), np.zeros((n, 2)), np.array([s.bodies for s in starts]))
    batch.set_gains(rows, np.tile([kp, 50.0], (n, 1)), np.tile([100.0, 0.2], (n, 1)), np.zeros((n, 2)))


def make(specs: Sequence[WorldSpec], starts: Sequence[Start], engine: str = "warp") -> WorldBatch:
    """A batch with everything placed."""
    n = len(specs)
    batch = make_batch(engine, specs, BatchState(np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 5, 13))))
    begin(batch, range(n), starts)
    return batch


def advance(batch: WorldBatch, steps: int, substeps: int = 1, rows: Sequence[int] | None = None) -> None:
    n = len(batch.state.gc)
    for _ in range(steps):
        batch.advance(range(n) if rows is None else rows, np.zeros((n, 2)), substeps)


def everything(batch: WorldBatch, rows: Sequence[int] | slice = slice(None)) -> Array:
    """(R, 4 + 65): the states of rows in one array."""
    state = batch.state
    return np.concatenate([state.gc[rows], state.gv[rows], state.bodies[rows].reshape(len(state.gc[rows]), -1)], axis=1)


def tilted(tangent: float) -> tuple[Array, Start]:
    """A plane that falls towards +x with a block on it, and the plane's rotation."""
    R = matrix_from_rotation_vector(np.array([0.0, np.arctan(tangent), 0.0]))
    turn = quaternion_from_matrix(R)
    return R, Start({GROUND: [*R @ [0, 0, -0.5], *turn], LOW: [*R @ [0, 0, 0.03], *turn]})


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


def busy(k: int) -> Start:
    """A start of world k in which much happens: a block slides, another falls onto the plate, balls collide."""
    return Start({
        LOW: [0, 0, 0.03, 1, 0, 0, 0, 0.5 + 0.1 * k], HIGH: [0, 15, 0.15 + 0.01 * k, 1],
        FIRST: [0, 2, 0.05, 1, 0, 0, 0, 1], SECOND: [0.2, 2.01, 0.05, 1],
    })  # fmt: skip


def test_it_agrees_with_mujoco(machine: UrdfModel) -> None:
    """The same worlds in double precision, with the same model and the same law."""
    starts = [busy(k) for k in range(2)]
    here, there = (make([world_spec(machine)] * 2, starts, engine) for engine in ("warp", "mujoco"))
    for batch in (here, there):
        advance(batch, 6, 13)
    assert everything(here) == pytest.approx(everything(there), abs=2e-3)
    assert np.abs(everything(here) - everything(there))[:, :4].max() < 1e-4
    for batch in (here, there):
        batch.close()


def test_rows_that_do_not_advance_keep_their_state_to_the_bit(machine: UrdfModel) -> None:
    starts = [busy(k) for k in range(4)]
    parted, whole = (make([world_spec(machine)] * 4, starts) for _ in range(2))
    impulse = np.zeros((4, 2))
    advance(parted, 5, 13)
    parted.link_impulses(range(4), HIGH, impulse)
    before, pressed = everything(parted), impulse.copy()
    advance(parted, 5, 13, rows=[3, 1])
    assert np.array_equal(everything(parted, [0, 2]), before[[0, 2]])
    assert (everything(parted, [1, 3]) != before[[1, 3]]).sum() > 20
    parted.link_impulses(range(4), HIGH, impulse)
    assert np.array_equal(impulse[[0, 2]], pressed[[0, 2]]) and pressed.any()
    # Later they go on as if the others had not been advanced in between.
    advance(parted, 5, 13, rows=[0, 2])
    advance(whole, 10, 13)
    assert np.array_equal(everything(parted), everything(whole))
    for batch in (parted, whole):
        batch.close()


def test_a_row_that_breaks_harms_no_other_row_of_its_group(machine: UrdfModel) -> None:
    starts = [busy(k) for k in range(3)]
    batch, sound = (make([world_spec(machine)] * 3, starts) for _ in range(2))
    for one, value in ((batch, np.nan), (sound, 0.0)):
        advance(one, 2, 13)
        targets = np.zeros((3, 2))
        targets[1] = value
        with np.errstate(invalid="ignore"):
            one.advance(range(3), targets, 13)
    assert batch.broken().tolist() == [False, True, False] and not sound.broken().any()
    advance(batch, 3, 13)
    advance(sound, 3, 13)
    assert batch.broken().tolist() == [False, True, False]
    assert np.array_equal(everything(batch, [0, 2]), everything(sound, [0, 2]))
    batch.rebuild([1])
    for one in (batch, sound):
        begin(one, [1], [busy(7)])
        assert not one.broken().any()
        advance(one, 4, 13)
    assert np.array_equal(everything(batch), everything(sound))
    for one in (batch, sound):
        one.close()


def test_a_row_placed_twice_does_the_same_twice(machine: UrdfModel) -> None:
    batch, ends = make([world_spec(machine)] * 2, [busy(0), busy(3)]), []
    for _ in range(2):
        begin(batch, [0], [busy(5)])
        assert batch.state.bodies[0].tolist() == busy(5).bodies.tolist() and not batch.state.gv[0].any()
        touching = np.full(2, np.nan)
        batch.touching([0], LOW, GROUND, touching)
        assert touching[0] == 0.0
        advance(batch, 8, 13)
        ends.append(everything(batch)[0].tolist())
    assert ends[0] == ends[1]
    batch.close()


def test_worlds_with_other_shapes_are_another_group(machine: UrdfModel) -> None:
    specs = [world_spec(machine, height=height) for height in (0.06, 0.1, 0.06)]
    starts = [Start({LOW: [0, 0, spec.bodies[LOW].shapes[0].size[2] / 2, 1]}) for spec in specs]
    batch = make(specs, starts)
    assert [len(group.qpos) for group in batch.groups] == [2, 1]  # type: ignore[attr-defined]
    advance(batch, 2, 13)
    assert batch.state.bodies[:, LOW, 2] == pytest.approx([0.03, 0.05, 0.03], abs=1e-4)
    assert (batch.seconds > 0.0).all()
    batch.close()


def test_graphs_do_what_single_launches_do(machine: UrdfModel, monkeypatch: pytest.MonkeyPatch) -> None:
    graphs, launches = (make([world_spec(machine)], [busy(0)]) for _ in range(2))
    advance(graphs, 6, 13)
    group = launches.groups[0]  # type: ignore[attr-defined]
    monkeypatch.setattr(group, "_run", group._launch)
    advance(launches, 6, 13)
    assert np.array_equal(everything(graphs), everything(launches))
    for batch in (graphs, launches):
        batch.close()


def test_room_for_contacts_grows(machine: UrdfModel, monkeypatch: pytest.MonkeyPatch) -> None:
    from raisim_like.engines.mujoco_warp import group

    usual = make([world_spec(machine)] * 2, [busy(0), busy(1)])
    advance(usual, 6, 13)
    monkeypatch.setattr(group, "CONTACTS", 2)
    narrow = make([world_spec(machine)] * 2, [busy(0), busy(1)])
    advance(narrow, 6, 13)
    assert narrow.groups[0].contacts > 2  # type: ignore[attr-defined]
    assert np.array_equal(everything(narrow), everything(usual))
    monkeypatch.setattr(group, "MOST_CONTACTS", 2)
    with pytest.raises(EngineError, match="a world has more than 2 contacts; use fewer collision parts"):
        advance(make([world_spec(machine)], [busy(0)]), 6, 13)
    for batch in (usual, narrow):
        batch.close()


def test_concave_meshes_are_refused_as_on_mujoco(machine: UrdfModel) -> None:
    spec = world_spec(machine)
    body = replace(spec.bodies[LOW], shapes=(Shape("mesh", file=Path("bowl.obj")),))
    with pytest.raises(EngineError, match=r"bowl\.obj: MuJoCo has no concave meshes"):
        make([replace(spec, bodies=(spec.bodies[GROUND], body, *spec.bodies[2:]))], [Start()])


def test_environments_of_the_hand_run_in_one_pool() -> None:
    """With the actions of the label's own pose, hand and object do what they do on MuJoCo."""
    seen = []
    for engine in ("warp", "mujoco"):
        pool = make_pool(make_spec(2, [f"engine={engine}", "env.grasp_steps=3"]))
        pool.reset(0, "test")
        for _ in range(6):
            step = pool.step(np.zeros((2, pool.action_size), np.float32))
        seen.append(step.observation.copy())
        pool.close()
    assert seen[0] == pytest.approx(seen[1], abs=2e-2) and np.isfinite(seen[0]).all()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("mujoco_warp", "warp"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, name, None)
            with pytest.raises(EngineError, match=r"needs the packages mujoco-warp and warp-lang.*'dgrasp\[warp\]'"):
                find_engine("warp")
