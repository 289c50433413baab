"""Worlds that are saved and restored: what follows is identical to the bit."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dgrasp.hand.free.hand import URDF_PATH
from raisim_like import ArticulatedSystem, EngineError, RigidBody, World, read_urdf
from tests.raisim_like.urdfs import write_chain

Scene = tuple[World, ArticulatedSystem, RigidBody, RigidBody]


@pytest.fixture
def scene(engine: str) -> Iterator[Scene]:
    """A hand that has closed on a ball, and a box that slides by."""
    world = World(engine)
    hand = world.add_articulated_system(read_urdf(URDF_PATH))
    hand.set_base_pose((0, 0, 0.06))
    ball, box = world.add_sphere(0.035, 0.1), world.add_box(0.05, 0.05, 0.05, 0.1)
    world.add_ground()
    ball.set_state((-0.09, 0.01, 0.036))
    box.set_state((0.2, 0, 0.03), linear=(0.5, 0, 0))
    hand.set_pd_gains(50, 0.2)
    hand.set_pd_target(target(0.9))
    world.integrate(130)
    assert hand.contacts() and box.contacts()
    yield world, hand, ball, box
    world.close()


def target(bend: float) -> list[float]:
    return [bend if i >= 6 and i % 3 == 2 else 0.0 for i in range(51)]


def numbers(scene: Scene) -> list[float]:
    world, hand, ball, box = scene
    gc, gv = hand.state
    contacts = [c for body in (hand, ball, box) for c in body.contacts()]
    impulses = sorted(c.impulse for c in contacts)
    return [*gc, *gv, *ball.state, *box.state, world.world_time, *impulses]


def run(scene: Scene) -> list[list[float]]:
    made = []
    for _ in range(8):
        scene[0].integrate(13)
        made.append(numbers(scene))
    return made


def test_a_run_can_be_repeated(scene: Scene) -> None:
    world = scene[0]
    snapshot = world.save()
    first = run(scene)
    world.restore(snapshot)
    assert run(scene) == first
    assert first[0] != first[7]


def test_whatever_came_in_between(scene: Scene) -> None:
    world, hand, ball, box = scene
    snapshot = world.save()
    first = run(scene)
    rng = np.random.default_rng(0)
    for _ in range(3):
        hand.set_pd_target(rng.uniform(-0.5, 0.5, 51))
        hand.set_pd_gains(500.0, 1.0)
        hand.set_generalized_force(rng.uniform(-0.1, 0.1, 51))
        hand.set_base_pose((0, 0, 0.5))
        ball.set_state((3, 3, 3))
        box.set_external_force((0, 0, 5))
        world.set_gravity((1, 0, 0))
        world.integrate(40)
        world.engine_world.forget_contacts()
        hand.set_state(rng.uniform(-0.5, 0.5, 51))
        box.set_external_force((0, 0, 5))
        world.restore(snapshot)
        assert world.gravity.tolist() == [0, 0, -9.81]
        assert run(scene) == first


def test_a_snapshot_holds_what_is_about_to_act(scene: Scene) -> None:
    world, hand, _, box = scene
    quiet = world.save()
    box.set_external_force((0, 0, 5))
    hand.set_external_force(hand.body_names[-1], (0, 0, 0.5))
    pushed = world.save()
    first = run(scene)
    world.restore(quiet)
    assert run(scene) != first
    world.restore(pushed)
    assert run(scene) == first


def test_snapshots_of_several_times(scene: Scene) -> None:
    world = scene[0]
    snapshots, ends = [], []
    for bend in (0.2, 0.9, 0.5):
        scene[1].set_pd_target(target(bend))
        snapshots.append(world.save())
        ends.append(run(scene))
    for k in (1, 0, 2, 0):
        world.restore(snapshots[k])
        assert run(scene) == ends[k]


def test_a_snapshot_is_of_one_world_and_its_bodies(scene: Scene, tmp_path: Path) -> None:
    world = scene[0]
    snapshot = world.save()
    other = World(world.engine.name)
    with pytest.raises(EngineError, match="belongs to another world"):
        other.restore(snapshot)
    other.close()
    arm = world.add_articulated_system(write_chain(tmp_path / "arm.urdf"))
    with pytest.raises(EngineError, match="bodies were added or removed"):
        world.restore(snapshot)
    world.remove(arm)


def test_snapshots_may_outlive_their_world(engine: str) -> None:
    world = World(engine)
    world.add_sphere(0.1, 1.0)
    snapshots = [world.save() for _ in range(3)]
    del snapshots[0]
    gc.collect()
    world.close()
    del snapshots
    gc.collect()


def test_snapshots_of_a_closed_world_leave_later_ones_alone(engine: str) -> None:
    """A new world reuses the closed one's numbers, its own and those of its states."""
    closed = World(engine)
    closed.add_sphere(0.1, 1.0)
    old = closed.save()
    closed.close()
    world = World(engine)
    ball = world.add_sphere(0.1, 1.0)
    snapshot = world.save()
    world.integrate(5)
    del old, closed
    gc.collect()
    world.restore(snapshot)
    assert ball.position.tolist() == [0.0, 0.0, 0.0]
    world.close()
