"""The interface to the engines: a batch equals its worlds alone, writes in place, and survives a world that breaks."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from raisim_like import ArticulatedSystem, EngineError, RigidBody, Shape, UrdfModel, World, read_urdf
from raisim_like.batch import Array, BatchState, BodySpec, SystemSpec, WorldBatch, WorldSpec
from raisim_like.material import MaterialTable
from raisim_like.registry import AT_ONCE, BATCHES, find_engine, in_parts, make_batch
from raisim_like.world import BODY, STATIC, SYSTEM, collision_mask
from tests.raisim_like.urdfs import write_chain

ANY = STATIC | BODY | SYSTEM
BALL, BOX, GROUND = 0, 1, 2
DT, SUBSTEPS = 0.00222, 13
AT = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def arms(tmp_path: Path) -> tuple[UrdfModel, UrdfModel]:
    """Two different arms: 2 and 3 joints."""
    return read_urdf(write_chain(tmp_path / "two.urdf", 2, tip_radius=0.05)), read_urdf(
        write_chain(tmp_path / "three.urdf", 3, tip_radius=0.05)
    )


def spec(arms: Sequence[UrdfModel], seed: int) -> WorldSpec:
    """Two arms, a ball and a box whose sizes differ between worlds, and the ground."""
    radius, side = 0.04 + 0.01 * seed, 0.1 + 0.02 * seed
    bodies = (
        BodySpec((Shape("sphere", (radius,)),), 0.2, 1e-4 * np.eye(3), np.zeros(3), "ball", collision_mask(BODY, ANY)),
        BodySpec((Shape("box", (side, side, side)),), 0.5, 1e-3 * np.eye(3), np.array([0.01, 0.0, -0.01]), "box",
                 collision_mask(BODY, ANY)),
        BodySpec((Shape("box", (4.0, 4.0, 1.0)),), 0.0, np.eye(3), np.zeros(3), "ground", collision_mask(STATIC, ANY)),
    )  # fmt: skip
    systems = tuple(SystemSpec(arm, "arm", collision_mask(SYSTEM, ANY), enforce_limits=False) for arm in arms)
    return WorldSpec(systems, bodies, DT, gravity=(0.0, 0.1, -9.0), materials=MaterialTable(0.4))


class Start:
    """The start of world `seed`, and its drive."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.bases = np.array([[0.0, 0.0, 0.35, *AT], [0.0, 0.6, 0.5, *AT]])
        self.gc, self.target = rng.uniform(-0.3, 0.3, (2, 5))
        self.bodies = np.zeros((3, 13))
        self.bodies[:, :3] = [[0.2, 0.01 * seed, 0.5], [0.7, 0.0, 0.055 + 0.01 * seed], [0.0, 0.0, -0.5]]
        self.bodies[:, 3:7] = AT
        self.bodies[BALL, 8] = 0.1
        self.kp, self.kd, self.force = np.full(5, 20.0 + seed), np.full(5, 0.3), rng.uniform(-0.1, 0.1, 5)


def make(engine: str, arms: Sequence[UrdfModel], seeds: Sequence[int]) -> WorldBatch:
    n = len(seeds)
    state = BatchState(np.full((n, 5), np.nan), np.full((n, 5), np.nan), np.full((n, 3, 13), np.nan))
    return make_batch(engine, [spec(arms, seed) for seed in seeds], state)


def begin(batch: WorldBatch, rows: Sequence[int], seeds: Sequence[int]) -> None:
    starts = [Start(seed) for seed in seeds]
    batch.place(rows, *(np.array([getattr(s, name) for s in starts]) for name in ("bases", "gc", "bodies")))
    batch.set_gains(rows, *(np.array([getattr(s, name) for s in starts]) for name in ("kp", "kd", "force")))


def targets(seeds: Sequence[int]) -> Array:
    return np.array([Start(seed).target for seed in seeds])


def copied(state: BatchState) -> list[Array]:
    return [state.gc.copy(), state.gv.copy(), state.bodies.copy()]


def row_of(state: BatchState, i: int) -> list[list[float]]:
    return [array[i].ravel().tolist() for array in (state.gc, state.gv, state.bodies)]


def alone(engine: str, arms: Sequence[UrdfModel], seed: int, steps: int) -> World:
    """The same world through RaiSim's objects."""
    start = Start(seed)
    world = World(engine, DT)
    world.set_gravity((0.0, 0.1, -9.0))
    world.set_default_material(0.4)
    systems = [world.add_articulated_system(arm, "arm", enforce_limits=False) for arm in arms]
    bodies = []
    for body in spec(arms, seed).bodies:
        bodies.append(
            world.add_body(body.shapes, body.mass, body.inertia, body.center_of_mass, body.material, body.mask)
        )
    world.engine_world.forget_contacts()
    bodies[GROUND].set_state(start.bodies[GROUND, :3])
    for system, base, part in zip(systems, start.bases, (slice(0, 2), slice(2, 5)), strict=True):
        system.set_base_pose(base[:3], base[3:])
        system.set_state(start.gc[part])
        system.set_pd_gains(start.kp[part], start.kd[part])
        system.set_generalized_force(start.force[part])
        system.set_pd_target(start.target[part])
    for k in (BALL, BOX):
        state = start.bodies[k]
        bodies[k].set_state(state[:3], state[3:7], state[7:10], state[10:])
    for _ in range(steps):
        world.integrate(SUBSTEPS)
    return world


def items(world: World) -> tuple[list[ArticulatedSystem], list[RigidBody]]:
    systems = [item for item in world.objects if isinstance(item, ArticulatedSystem)]
    return systems, [item for item in world.objects if isinstance(item, RigidBody)]


def test_a_batch_is_its_worlds_alone_to_the_bit(engine: str, arms: tuple[UrdfModel, UrdfModel]) -> None:
    seeds, steps = (1, 2, 3), 12
    batch = make(engine, arms, seeds)
    begin(batch, range(3), seeds)
    for _ in range(steps):
        batch.advance(range(3), targets(seeds), SUBSTEPS)
    impulses, touching, apart = np.full((3, 5), np.nan), np.full(3, np.nan), np.full(3, np.nan)
    batch.link_impulses(range(3), BALL, impulses)
    batch.touching(range(3), BOX, GROUND, touching)
    batch.touching(range(3), BOX, BALL, apart)
    for i, seed in enumerate(seeds):
        world = alone(engine, arms, seed, steps)
        systems, bodies = items(world)
        gc = np.concatenate([system.generalized_coordinate for system in systems])
        gv = np.concatenate([system.generalized_velocity for system in systems])
        assert row_of(batch.state, i) == [gc.tolist(), gv.tolist(), [x for body in bodies for x in body.state.tolist()]]
        expected = np.zeros(5)
        for system, first in zip(systems, (0, 2), strict=True):
            for contact in system.contacts():
                if contact.body_b == bodies[BALL].id:
                    expected[first + contact.link_a] += contact.impulse
        assert impulses[i] == pytest.approx(expected, abs=1e-15)
        assert touching[i] == any(c.body_b == bodies[GROUND].id for c in bodies[BOX].contacts()) == 1.0
        assert apart[i] == 0.0
        world.close()
    assert not batch.broken().any()
    batch.close()


def test_the_arm_feels_the_ball_that_falls_on_it(engine: str, arms: tuple[UrdfModel, UrdfModel]) -> None:
    """The ball falls on the end of the first link of the first arm."""
    batch = make(engine, arms, (1,))
    begin(batch, [0], (1,))
    impulses, most = np.zeros((1, 5)), np.zeros(5)
    for _ in range(40):
        batch.advance([0], targets((1,)), SUBSTEPS)
        batch.link_impulses([0], BALL, impulses)
        most = np.maximum(most, impulses[0])
    assert most[1] == 0.0 < 1e-4 < most[0] and not most[2:].any()
    batch.close()


def test_arrays_are_written_in_place_and_other_rows_left_alone(
    engine: str, arms: tuple[UrdfModel, UrdfModel]
) -> None:
    whole = np.full((3, 2 * 5 + 3 * 13), np.nan)
    gc, gv, bodies = whole[:, :5], whole[:, 5:10], whole[:, 10:].reshape(3, 3, 13)
    assert np.shares_memory(bodies, whole)
    batch = make_batch(engine, [spec(arms, seed) for seed in (1, 2, 3)], BatchState(gc, gv, bodies))
    assert batch.state.gc is gc and batch.state.gv is gv and batch.state.bodies is bodies
    begin(batch, [2, 0], (3, 1))
    assert np.isfinite(whole[[0, 2]]).all() and np.isnan(whole[1]).all()
    assert gc[2].tolist() == Start(3).gc.tolist() and gc[0].tolist() == Start(1).gc.tolist()
    assert np.allclose(bodies[2], Start(3).bodies, atol=1e-12) and not gv[[0, 2]].any()
    before = whole.copy()
    batch.advance([2], targets((1, 2, 3)), SUBSTEPS)
    assert np.array_equal(whole[:2], before[:2], equal_nan=True) and (whole[2] != before[2]).sum() > 15
    out, touch = np.full((3, 5), 7.0), np.full(3, 7.0)
    batch.link_impulses([2], BOX, out)
    batch.touching([2], BALL, BOX, touch)
    assert (out[:2] == 7.0).all() and not out[2].any() and touch.tolist() == [7.0, 7.0, 0.0]
    batch.close()


def test_a_body_moves_while_all_else_goes_on(engine: str, arms: tuple[UrdfModel, UrdfModel]) -> None:
    """The ground drops by 1 m under the resting box, which then falls freely."""
    batch = make(engine, arms, (1, 2))
    begin(batch, range(2), (1, 2))
    for _ in range(30):
        batch.advance(range(2), targets((1, 2)), SUBSTEPS)
    lowered = Start(1).bodies[GROUND].copy()
    lowered[2] -= 1.0
    before = copied(batch.state)
    batch.move([0], GROUND, lowered[None])
    assert batch.state.bodies[0, GROUND].tolist() == lowered.tolist()
    before[2][0, GROUND] = lowered
    assert all(np.array_equal(a, b) for a, b in zip(copied(batch.state), before, strict=True))
    for _ in range(4):
        batch.advance(range(2), targets((1, 2)), SUBSTEPS)
    t = 4 * SUBSTEPS * DT
    assert batch.state.bodies[0, BOX, 9] == pytest.approx(-9.0 * t, abs=5e-3)
    assert abs(batch.state.bodies[1, BOX, 9]) < 1e-2
    assert batch.state.bodies[0, GROUND].tolist() == lowered.tolist()
    batch.close()


def test_a_row_that_broke_is_reported_and_rebuilt_and_no_other_notices(
    engine: str, arms: tuple[UrdfModel, UrdfModel]
) -> None:
    batch, sound = make(engine, arms, (1, 2, 3)), make(engine, arms, (1, 2, 3))
    aims = targets((1, 2, 3))
    for one in (batch, sound):
        begin(one, range(3), (1, 2, 3))
        one.advance(range(3), aims, SUBSTEPS)
    wild = aims.copy()
    wild[1, 3] = np.nan
    with np.errstate(all="ignore"):
        batch.advance(range(3), wild, SUBSTEPS)
    sound.advance(range(3), aims, SUBSTEPS)
    assert batch.broken().tolist() == [False, True, False] and not sound.broken().any()
    batch.advance([0, 2], aims, SUBSTEPS)
    sound.advance([0, 2], aims, SUBSTEPS)
    assert batch.broken().tolist() == [False, True, False]
    spent = batch.seconds
    batch.rebuild([1])
    assert np.array_equal(batch.seconds, spent) and (spent > 0).all()
    begin(batch, [1], (2,))
    assert not batch.broken().any()
    for _ in range(3):
        batch.advance(range(3), aims, SUBSTEPS)
        sound.advance([0, 2], aims, SUBSTEPS)
    for i in (0, 2):
        assert row_of(batch.state, i) == row_of(sound.state, i)
    fresh = make(engine, arms, (2,))
    begin(fresh, [0], (2,))
    for _ in range(3):
        fresh.advance([0], targets((2,)), SUBSTEPS)
    assert row_of(batch.state, 1) == row_of(fresh.state, 0)
    for one in (batch, sound, fresh):
        one.close()


def test_a_row_placed_anew_has_no_past(engine: str, arms: tuple[UrdfModel, UrdfModel]) -> None:
    batch = make(engine, arms, (1, 1))
    begin(batch, range(2), (1, 1))
    for _ in range(20):
        batch.advance([0], targets((1, 1)), SUBSTEPS)
    begin(batch, [0], (1,))
    for _ in range(20):
        batch.advance(range(2), targets((1, 1)), SUBSTEPS)
    assert row_of(batch.state, 0) == row_of(batch.state, 1)
    batch.close()


def test_the_time_inside_the_engine_is_counted_by_row(engine: str, arms: tuple[UrdfModel, UrdfModel]) -> None:
    batch = make(engine, arms, (1, 2))
    begin(batch, range(2), (1, 2))
    assert batch.seconds.tolist() == [0.0, 0.0]
    batch.advance([1], targets((1, 2)), SUBSTEPS)
    assert batch.seconds[0] == 0.0 < batch.seconds[1]
    batch.close()


def test_worlds_are_divided_into_parts_that_an_engine_takes_at_once() -> None:
    assert AT_ONCE["pybullet"] == 128 and "mujoco" not in AT_ONCE
    # 300 worlds in parts of at most 128 are 3 parts of 100; 257 are 3 of 85, 86 and 86.
    assert in_parts(300, "pybullet") == [slice(0, 100), slice(100, 200), slice(200, 300)]
    assert in_parts(257, "pybullet", 576) == [slice(0, 85), slice(85, 171), slice(171, 257)]
    assert in_parts(128, "pybullet") == [slice(0, 128)] and in_parts(3000, "mujoco") == [slice(0, 3000)]
    assert in_parts(3, "mujoco", 2) == [slice(0, 1), slice(1, 3)] and in_parts(0, "mujoco") == [slice(0, 0)]


def test_an_unknown_engine_is_refused_with_the_valid_names() -> None:
    with pytest.raises(EngineError, match="unknown engine 'physx'; expected one of pybullet, mujoco"):
        make_batch("physx", [], BatchState(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0, 13))))


def test_an_engine_that_is_not_installed_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(EngineError, match=r"needs the package pybullet.*pip install"):
        find_engine("pybullet")


def test_a_new_engine_is_one_line_of_the_registry(
    arms: tuple[UrdfModel, UrdfModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def maker(specs: Sequence[WorldSpec], state: BatchState, threads: int = 1) -> WorldBatch:
        asked.append(len(specs))
        return find_engine("mujoco")(specs, state)

    monkeypatch.setitem(BATCHES, "new", lambda: partial(maker))  # type: ignore[arg-type]
    batch = make("new", arms, (1, 2))
    begin(batch, range(2), (1, 2))
    assert asked == [2] and not batch.broken().any()
    batch.close()
