"""Friction per pair of materials: the table, what a product of coefficients can give, and blocks that slide by it."""

from __future__ import annotations

import itertools
import math

import pytest

from raisim_like import EngineError, World
from raisim_like.engines.bullet.friction import factors
from raisim_like.material import MaterialTable
from tests.engines import needs_pybullet

G = 9.81
SLIDING = {"pybullet": 1e-4, "mujoco": 5e-3}
"""m/s after 100 substeps; in MuJoCo a contact takes some substeps to find the force on a block that already moves."""


def pairs(*materials: str) -> set[frozenset[str]]:
    """All pairs that a world with these bodies has."""
    return {frozenset(pair) for pair in itertools.combinations(materials, 2)}


def test_unnamed_pairs_have_the_default() -> None:
    table = MaterialTable(0.8)
    table.set_pair("ice", "steel", 0.1)
    assert table.friction("steel", "ice") == 0.1
    assert table.friction("ice", "ice") == 0.8


def test_without_pairs_every_body_has_the_root_of_the_default() -> None:
    found = factors(MaterialTable(0.8), ["hand", "object", "table"], pairs("hand", "object", "table"))
    assert all(value == pytest.approx(math.sqrt(0.8), abs=1e-12) for value in found.values())


def test_factors_multiply_to_the_table() -> None:
    table = MaterialTable(0.8)
    table.set_pair("ice", "steel", 0.1)
    table.set_pair("ice", "wood", 0.3)
    found = factors(table, ["ice", "steel", "wood"], pairs("ice", "steel", "wood"))
    assert found["ice"] * found["steel"] == pytest.approx(0.1)
    assert found["ice"] * found["wood"] == pytest.approx(0.3)
    assert found["steel"] * found["wood"] == pytest.approx(0.8)


def test_one_body_alone_needs_no_pair() -> None:
    assert factors(MaterialTable(0.49), ["ice"], set()) == {"ice": pytest.approx(0.7)}


def test_what_a_product_cannot_give_is_refused() -> None:
    table = MaterialTable()
    table.set_pair("a", "a", 0.1)
    table.set_pair("b", "b", 0.1)
    table.set_pair("a", "b", 0.9)
    with pytest.raises(EngineError, match="multiplies one friction coefficient per body") as error:
        factors(table, ["a", "a", "b", "b"], pairs("a", "a", "b", "b"))
    assert "'a'" in str(error.value) and "products of one coefficient per material" in str(error.value)


@needs_pybullet
def test_the_world_refuses_it_when_the_second_body_makes_it_matter() -> None:
    world = World("pybullet")
    for first, second, friction in (("a", "a", 0.1), ("b", "b", 0.1), ("a", "b", 0.9)):
        world.set_material_pair(first, second, friction)
    for material in "aab":
        world.add_box(0.1, 0.1, 0.1, 1.0, material)
    with pytest.raises(EngineError, match="products of one coefficient"):
        world.add_box(0.1, 0.1, 0.1, 1.0, "b")
    world.close()


@pytest.mark.parametrize("friction", [-0.1, math.nan, math.inf])
def test_friction_is_a_number_from_zero_up(friction: float) -> None:
    with pytest.raises(EngineError, match="'a' and 'b'"):
        MaterialTable().set_pair("a", "b", friction)


@pytest.mark.parametrize(("first", "second"), [(0.1, 0.6), (0.0, 0.3)])
def test_blocks_slow_down_by_their_own_pairs(engine: str, first: float, second: float) -> None:
    world = World(engine)
    world.set_material_pair("first", "ground", first)
    world.add_ground(material="ground")
    blocks = [world.add_box(0.2, 0.2, 0.04, 1.0, material) for material in ("first", "second")]
    for i, block in enumerate(blocks):
        block.set_state((0, i, 0.02), linear=(2, 0, 0))
    world.set_material_pair("second", "ground", second)  # It also applies to existing bodies.
    world.integrate(100)
    for block, friction in zip(blocks, (first, second), strict=True):
        expected = 2.0 - friction * G * 100 * world.timestep
        assert block.linear_velocity[0] == pytest.approx(expected, abs=SLIDING[engine])
    world.close()


def test_the_default_can_change_later(engine: str) -> None:
    world = World(engine)
    world.add_ground()
    block = world.add_box(0.2, 0.2, 0.04, 1.0)
    world.set_default_material(0.25)
    block.set_state((0, 0, 0.02), linear=(2, 0, 0))
    world.integrate(100)
    assert block.linear_velocity[0] == pytest.approx(2.0 - 0.25 * G * 100 * world.timestep, abs=SLIDING[engine])
    world.close()


def test_a_body_that_left_asks_for_nothing() -> None:
    world = World()
    for first, second, friction in (("a", "a", 0.1), ("b", "b", 0.1), ("a", "b", 0.9)):
        world.set_material_pair(first, second, friction)
    bodies = [world.add_box(0.1, 0.1, 0.1, 1.0, material) for material in "aab"]
    world.remove(bodies[0])
    world.add_box(0.1, 0.1, 0.1, 1.0, "b")
    world.close()
