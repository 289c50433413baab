"""Worlds: independent of each other, the same alone and together, and what they refuse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dgrasp.hand.free.hand import URDF_PATH
from raisim_like import ArticulatedSystem, EngineError, RigidBody, Shape, UrdfModel, World, integrate, read_urdf
from raisim_like.engines import make_engine
from raisim_like.world import BODY, STATIC, SYSTEM, collision_mask
from tests.raisim_like.urdfs import write_chain


def hand_world(model: UrdfModel, seed: int, engine: str) -> tuple[World, ArticulatedSystem, RigidBody]:
    """A hand that closes towards a ball lying on the ground."""
    world = World(engine)
    hand = world.add_articulated_system(model)
    hand.set_base_pose((0, 0, 0.06))
    ball = world.add_sphere(0.035, 0.1)
    world.add_ground()
    ball.set_state((-0.09, 0.01, 0.036), linear=(0.1 * seed, 0, 0))
    hand.set_pd_gains(50, 0.2)
    hand.set_pd_target(np.random.default_rng(seed).uniform(-0.2, 0.6, hand.dof) * (np.arange(hand.dof) > 5))
    return world, hand, ball


def numbers(*items: ArticulatedSystem | RigidBody) -> list[float]:
    """Everything that the items' states hold."""
    values: list[float] = []
    for item in items:
        if isinstance(item, RigidBody):
            values += item.state.tolist()
        else:
            values += [*item.generalized_coordinate.tolist(), *item.generalized_velocity.tolist()]
    return values


def test_together_is_the_same_as_alone_to_the_bit(engine: str) -> None:
    model = read_urdf(URDF_PATH)
    together = [hand_world(model, seed, engine) for seed in (1, 2, 3)]
    for _ in range(4):
        integrate([world for world, _, _ in together], 13)
    for seed, (world, hand, ball) in zip((1, 2, 3), together, strict=True):
        alone, its_hand, its_ball = hand_world(model, seed, engine)
        for _ in range(4):
            alone.integrate(13)
        assert numbers(hand, ball) == numbers(its_hand, its_ball)
        alone.close()
        world.close()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_world_that_breaks_leaves_the_others_alone(engine: str, value: float) -> None:
    model = read_urdf(URDF_PATH)
    broken, sound, alone = (hand_world(model, seed, engine) for seed in (1, 2, 2))
    # Bypass the checks of `set_generalized_force`, as an unstable simulation would.
    broken[0].engine_world.set_feed_forward(broken[1].id, np.full(51, value))
    with np.errstate(all="ignore"):
        integrate([broken[0], sound[0]], 13)
    alone[0].integrate(13)
    assert not np.isfinite(broken[1].generalized_coordinate).all() or np.abs(broken[1].generalized_velocity).max() > 50
    assert numbers(*sound[1:]) == numbers(*alone[1:])
    for world, _, _ in (broken, sound, alone):
        world.close()


def test_worlds_of_one_process_do_not_know_each_other(engine: str, tmp_path: Path) -> None:
    path = write_chain(tmp_path / "arm.urdf", 2)
    first, second = World(engine), World(engine)
    second.set_gravity((0, 0, 0))
    arms = [world.add_articulated_system(path) for world in (first, second)]
    boxes = [world.add_box(0.1, 0.1, 0.1, 1.0) for world in (first, second)]
    for box in boxes:
        box.set_state((0, 0, 5))
    second.integrate(50)
    assert numbers(arms[1]) == [0.0] * 4 and boxes[1].position[2] == 5.0
    assert boxes[0].position[2] == 5.0 and first.world_time == 0.0
    first.integrate(50)
    assert boxes[0].position[2] < 4.95 and arms[0].generalized_coordinate[0] > 0.01
    first.close()
    second.integrate(10)
    assert boxes[1].position[2] == 5.0
    second.close()


def test_worlds_with_any_number_of_systems_go_together(engine: str, tmp_path: Path) -> None:
    """No system, two of different models, and one with another timestep: each is controlled as if it were alone."""
    one, three = write_chain(tmp_path / "one.urdf"), write_chain(tmp_path / "three.urdf", 3)

    def make() -> list[tuple[World, list[ArticulatedSystem | RigidBody]]]:
        made: list[tuple[World, list[ArticulatedSystem | RigidBody]]] = []
        for paths, timestep in (((), 0.00222), ((one, three), 0.00222), ((one,), 0.001)):
            world = World(engine, timestep)
            items: list[ArticulatedSystem | RigidBody] = [world.add_sphere(0.05, 0.1)]
            items[0].set_state((0, 0, 5))
            for i, path in enumerate(paths):
                system = world.add_articulated_system(path)
                system.set_base_pose((0, i, 0))
                system.set_pd_gains(50, 0.2)
                system.set_pd_target(0.3)
                items.append(system)
            made.append((world, items))
        return made

    together, apart = make(), make()
    integrate([world for world, _ in together], 300)
    for world, _ in apart:
        world.integrate(300)
    for (_, items), (_, its) in zip(together, apart, strict=True):
        assert numbers(*items) == numbers(*its)
    # Both systems of the second world sag a little below their target; without control they would hang down.
    for system in together[1][1][1:]:
        assert np.abs(system.generalized_coordinate - 0.3).max() < 0.2
    for world, _ in together + apart:
        world.close()


def test_models_that_come_and_go_are_not_mistaken_for_each_other(engine: str, tmp_path: Path) -> None:
    """A new model may get the memory address of an old one; its joint axes are its own."""
    for joints in (1, 3, 2, 4, 1, 3):
        world = World(engine)
        system = world.add_articulated_system(write_chain(tmp_path / "chain.urdf", joints))
        world.integrate(1)
        assert system.generalized_coordinate.shape == (joints,)
        world.close()
        del system, world


def test_time_is_counted(engine: str) -> None:
    world = World(engine, 0.002)
    world.integrate(13)
    integrate([world], 7)
    assert world.world_time == pytest.approx(0.04)
    assert world.engine_world.step_seconds > 0.0
    integrate([], 5)
    world.close()
    world.close()


def test_bodies_can_be_removed(engine: str) -> None:
    world = World(engine)
    world.add_ground()
    below, above = world.add_box(0.2, 0.2, 0.2, 1.0), world.add_sphere(0.1, 1.0)
    below.set_state((0, 0, 0.1))
    above.set_state((0, 0, 0.3))
    world.integrate(100)
    assert above.position[2] == pytest.approx(0.3, abs=1e-3)
    world.remove(below)
    hand = world.add_articulated_system(URDF_PATH)
    hand.set_base_pose((0, 0, 5))
    world.remove(hand)
    world.integrate(200)
    assert above.position[2] == pytest.approx(0.1, abs=5e-3)
    world.close()


def test_masks_say_who_meets_whom(engine: str) -> None:
    world = World(engine)
    world.add_ground()
    balls = []
    for i, hits in enumerate((STATIC | BODY, STATIC, BODY, SYSTEM)):
        balls.append(world.add_body([Shape("sphere", (0.05,))], 1.0, np.eye(3), mask=collision_mask(BODY, hits)))
        balls[-1].set_state((i, 0, 0.051))
    world.integrate(60)
    # The ground collides with everything, but a ball that does not collide with the ground falls through it.
    assert [bool(ball.position[2] > 0.04) for ball in balls] == [True, True, False, False]
    world.close()


def test_what_a_world_refuses() -> None:
    with pytest.raises(EngineError, match="unknown engine 'physx'; expected one of pybullet, mujoco"):
        make_engine("physx")
    for timestep in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="timestep must be positive"):
            World(timestep=timestep)


def test_cylinders_roll_and_boxes_have_the_inertia_of_solids(engine: str) -> None:
    """Rolling down: a solid cylinder on its side gains 2/3 of g sin a, whatever its size."""
    world = World(engine)
    angle = 0.2
    world.set_gravity((9.81 * np.sin(angle), 0, -9.81 * np.cos(angle)))
    world.add_ground()
    cylinder = world.add_cylinder(0.05, 0.2, 0.7)
    cylinder.set_state((0, 0, 0.05), (np.sqrt(0.5), np.sqrt(0.5), 0, 0))
    world.integrate(200)
    gained = cylinder.linear_velocity[0] / world.world_time
    assert gained == pytest.approx(2 / 3 * 9.81 * np.sin(angle), rel=0.02)
    assert cylinder.angular_velocity[1] == pytest.approx(cylinder.linear_velocity[0] / 0.05, rel=0.02)
    world.close()
