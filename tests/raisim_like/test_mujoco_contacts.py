"""MuJoCo's contacts that slide: the correction that keeps them closed, checked against its own list of contacts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from raisim_like import World
from tests.raisim_like.urdfs import write_chain

if TYPE_CHECKING:
    from raisim_like.engines.mujoco.model import BuiltModel

mujoco = pytest.importorskip("mujoco")

DT = 0.00222


@pytest.fixture
def world() -> Iterator[World]:
    made = World("mujoco", DT)
    yield made
    made.close()


def compiled(world: World) -> BuiltModel:
    """MuJoCo's own model and data of a world."""
    from raisim_like.engines.mujoco.world import MujocoWorld

    assert isinstance(world.engine_world, MujocoWorld)
    return world.engine_world._ready()


@pytest.mark.parametrize("default", [0.6, 0.0])
@pytest.mark.parametrize("pair", [None, 0.25])
def test_sliding_contacts_aim_lower_by_friction_times_their_speed(
    world: World, tmp_path: Path, default: float, pair: float | None
) -> None:
    """To the bit what MuJoCo's own list of contacts says, with a joint at its stop before them in the constraints."""
    from raisim_like.engines.mujoco.contacts import SlidingContacts
    from raisim_like.engines.mujoco.model import CONTACT_MARGIN

    world.set_default_material(default)
    if pair is not None:
        world.set_material_pair("ice", "default", pair)
    world.add_ground()
    arm = world.add_articulated_system(write_chain(tmp_path / "arm.urdf", limit=0.2))
    arm.set_base_pose((0, 0, 3))
    arm.set_state([0.25])
    blocks = [world.add_box(0.1, 0.1, 0.1, 1.0, material) for material in ("ice", "wood", "wood", "wood")]
    # The last one hangs over the ground, in the margin and out of reach.
    for i, (block, z) in enumerate(zip(blocks, (0.05, 0.05, 0.0499, 0.05 + 2 * CONTACT_MARGIN), strict=True)):
        block.set_state((i, 0, z), linear=(1.0 + i, 0.3, 0))
    built = compiled(world)
    data = built.data
    assert (built.model.npair > 0) == (pair is not None)
    mujoco.mj_step1(built.model, data)
    contacts = [c for c in data.contact if c.efc_address >= 0]
    assert data.nl == 1 and data.nefc == 1 + 3 * len(contacts) and len(contacts) >= 12
    aim = data.efc_aref.copy()
    expected = aim.copy()
    for c in contacts:
        velocity = data.efc_vel[c.efc_address : c.efc_address + 3]
        expected[c.efc_address] -= c.friction[0] * np.hypot(velocity[1], velocity[2]) / built.model.opt.timestep
    SlidingContacts(built, default).keep_closed()
    assert data.efc_aref.tolist() == expected.tolist() and (expected != aim).sum() == len(contacts)


def test_the_correction_takes_any_number_of_contacts(world: World) -> None:
    from raisim_like.engines.mujoco.contacts import SlidingContacts

    world.add_ground()
    for i in range(30):
        world.add_box(0.1, 0.1, 0.1, 1.0).set_state((0.2 * (i % 6), 0.2 * (i // 6), 0.05), linear=(0.5, 0, 0))
    built = compiled(world)
    mujoco.mj_step1(built.model, built.data)
    assert built.data.nefc == 3 * 120
    before = built.data.efc_aref.copy()
    SlidingContacts(built, 0.8).keep_closed()
    change = (before - built.data.efc_aref).reshape(-1, 3)
    assert change[:, 0] == pytest.approx(0.8 * 0.5 / DT) and not change[:, 1:].any()
