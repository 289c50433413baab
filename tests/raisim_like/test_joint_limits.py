"""Joint limits under PD control: they hold, they can be left to the targets, and they throw nothing back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from raisim_like import ArticulatedSystem, World
from tests.raisim_like.urdfs import write_chain

DT = 0.00222
LIMIT = 0.5

Arm = Callable[..., ArticulatedSystem]


@pytest.fixture
def world(engine: str) -> Iterator[World]:
    made = World(engine, DT)
    made.set_gravity((0, 0, 0))
    yield made
    made.close()


@pytest.fixture
def arm(world: World, tmp_path: Path) -> Arm:
    """Makes an arm of one joint that turns by at most `LIMIT` to either side."""

    def make(**options: bool) -> ArticulatedSystem:
        system = world.add_articulated_system(write_chain(tmp_path / "arm.urdf", limit=LIMIT), **options)
        system.set_pd_gains(50.0, 0.2)
        return system

    return make


@pytest.mark.parametrize("target", [0.6, -2.9])
def test_joint_limits_hold(world: World, arm: Arm, target: float) -> None:
    system = arm()
    system.set_pd_target([target])
    fastest = 0.0
    for _ in range(60):
        world.integrate(1)
        fastest = max(fastest, abs(system.generalized_velocity[0]))
    # The limit acts once the joint has passed it, at most one substep late, and nothing pulls the joint back.
    stopped = system.generalized_coordinate[0]
    # MuJoCo's limit gives way by a ten-thousandth of what the motor would do in each substep.
    creep = 1e-9 if world.engine.name == "pybullet" else 2e-3 * abs(target - stopped)
    assert LIMIT <= abs(stopped) <= LIMIT + fastest * DT
    world.integrate(200)
    assert system.generalized_coordinate[0] == pytest.approx(stopped, abs=creep)


def test_limits_can_be_left_to_the_targets(world: World, arm: Arm) -> None:
    system = arm(enforce_limits=False)
    system.set_pd_target([0.9])
    world.integrate(400)
    assert system.generalized_coordinate[0] == pytest.approx(0.9, abs=1e-9)
    assert system.joint_limits.tolist() == [[-LIMIT, LIMIT]]


def test_a_joint_that_starts_beyond_its_limit_is_not_thrown(world: World, arm: Arm) -> None:
    system = arm()
    system.set_state([1.5])
    system.set_pd_target([1.5])
    world.integrate(100)
    assert system.generalized_coordinate[0] == pytest.approx(1.5, abs=1e-9)
    system.set_pd_target([LIMIT])
    world.integrate(400)
    assert system.generalized_coordinate[0] == pytest.approx(LIMIT, abs=1e-6)
