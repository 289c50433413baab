"""Contact impulses: which bodies press on each other, how hard, and in which direction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from dgrasp.types import Array
from raisim_like import RigidBody, World

DT, G = 0.00222, 9.81


@pytest.fixture
def world(engine: str) -> Iterator[World]:
    made = World(engine, DT)
    yield made
    made.close()


def force(body: RigidBody, other: RigidBody) -> Array:
    """(3,) N: the whole contact force of `other` on `body` in the last substep."""
    found = [c for c in body.contacts() if c.body_b == other.id]
    assert all(c.body_a == body.id for c in found)
    return sum((c.impulse * c.normal_W + c.tangential_impulse_W for c in found), start=np.zeros(3)) / DT


def test_a_stack_carries_its_weight(world: World) -> None:
    ground, below, above = world.add_ground(), world.add_box(0.2, 0.2, 0.1, 1.2), world.add_box(0.1, 0.1, 0.1, 0.7)
    below.set_state((0, 0, 0.05))
    above.set_state((0, 0, 0.15))
    world.integrate(300)
    assert force(below, ground) == pytest.approx([0, 0, 1.9 * G], abs=1e-6)
    assert force(above, below) == pytest.approx([0, 0, 0.7 * G], abs=1e-6)
    assert not [c for c in above.contacts() if c.body_b == ground.id]


@pytest.mark.parametrize("ground_first", [True, False])
def test_action_is_reaction_whoever_asks(world: World, ground_first: bool) -> None:
    world.set_default_material(0.5)
    if ground_first:
        ground, box = world.add_ground(), world.add_box(0.3, 0.3, 0.06, 1.0)
    else:
        box, ground = world.add_box(0.3, 0.3, 0.06, 1.0), world.add_ground()
    box.set_state((0, 0, 0.03), linear=(1.5, 0, 0))
    world.integrate(60)
    pressed = 0
    for _ in range(5):
        before = box.linear_velocity
        world.integrate(1)
        on_box = force(box, ground)
        assert force(ground, box) == pytest.approx(-on_box, abs=1e-12)
        # Newton's second law for the box in this substep.
        assert (box.linear_velocity - before) / DT == pytest.approx(on_box - [0, 0, G], abs=1e-6)
        assert on_box[0] == pytest.approx(-0.5 * on_box[2], abs=1e-6)
        pressed += on_box[2] > 1.0
    assert pressed > 0


def test_an_impact_changes_momentum_by_its_impulse(world: World) -> None:
    world.set_gravity((0, 0, 0))
    first, second = world.add_sphere(0.05, 1.0), world.add_sphere(0.05, 2.5)
    first.set_state((0, 0, 0), linear=(1, 0, 0))
    second.set_state((0.15, 0, 0))
    total = np.zeros(3)
    for _ in range(60):
        world.integrate(1)
        total += DT * force(second, first)
    # Both leave at 1 / 3.5 m/s, so the second has received 2.5 / 3.5 N s.
    assert total == pytest.approx([2.5 / 3.5, 0, 0], abs=1e-9)


def test_points_and_depths_lie_where_the_bodies_touch(world: World) -> None:
    ground, ball = world.add_ground(0.3), world.add_sphere(0.05, 0.4)
    ball.set_state((0.2, -0.1, 0.352))
    world.integrate(200)
    (contact,) = ball.contacts()
    assert (contact.body_b, contact.link_a, contact.link_b) == (ground.id, -1, -1)
    assert contact.point_W == pytest.approx([0.2, -0.1, 0.3], abs=1e-6)
    assert contact.normal_W == pytest.approx([0, 0, 1], abs=1e-9)
    assert contact.depth == pytest.approx(0.35 - ball.position[2], abs=1e-6)
    (turned,) = ground.contacts()
    assert turned.normal_W == pytest.approx([0, 0, -1], abs=1e-9)
    assert turned.point_W[2] == pytest.approx(ball.position[2] - 0.05, abs=1e-6)
    assert world.engine_world.touching(ball.id, ground.id) and world.engine_world.touching(ground.id, ball.id)


def test_nothing_touches_in_the_air(world: World) -> None:
    ground, ball = world.add_ground(), world.add_sphere(0.05, 0.4)
    ball.set_state((0, 0, 1))
    world.integrate(3)
    assert ball.contacts() == [] and not world.engine_world.touching(ball.id, ground.id)
