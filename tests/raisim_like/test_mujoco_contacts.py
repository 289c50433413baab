"""MuJoCo's contacts that slide: the correction that keeps them closed, checked against its own list of contacts."""

from __future__ import annotations

import ctypes
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from raisim_like import World
from raisim_like.batch import Preset
from tests.raisim_like.urdfs import write_chain

if TYPE_CHECKING:
    from raisim_like.engines.mujoco.built import BuiltModel

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
    from raisim_like.engines.mujoco.model import CONTACT_MARGIN
    from raisim_like.engines.mujoco.sliding import keep_closed

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
    keep_closed(built.model, data)
    assert data.efc_aref.tolist() == expected.tolist() and (expected != aim).sum() == len(contacts)


def slide(world: World, tmp_path: Path) -> list[list[float]]:
    """States of sliding blocks, a rolling bar and a joint at its stop over some steps."""
    world.set_material_pair("ice", "default", 0.25)
    world.add_ground()
    arm = world.add_articulated_system(write_chain(tmp_path / "arm.urdf", limit=0.2))
    arm.set_base_pose((0, 0, 3))
    arm.set_state([0.25])
    bodies = [world.add_box(0.1, 0.1, 0.1, 1.0, material) for material in ("ice", "wood")]
    bodies.append(world.add_cylinder(0.01, 0.2, 0.02))
    for i, (body, z) in enumerate(zip(bodies, (0.05, 0.0499, 0.1), strict=True)):
        body.set_state((i, 0, z), linear=(1.0 + i, 0.3, 0))
    rows = []
    for _ in range(4):
        bodies[0].set_external_force((0.0, 1.0, 0.0))
        world.integrate(13)
        rows.append(np.concatenate([body.state for body in bodies] + [arm.generalized_coordinate]).tolist())
    return rows


@pytest.fixture
def callback() -> Iterator[None]:
    """Puts the callback back that was there before the test."""
    before = mujoco.get_mjcb_control()
    yield
    mujoco.set_mjcb_control(before)


def native_or_skip() -> None:
    from raisim_like.engines.mujoco import sliding

    if not sliding.native():
        pytest.skip("the part in C was not built: there was no C compiler when the package was installed")


def test_the_part_in_c_is_built_where_there_is_a_compiler() -> None:
    from raisim_like.engines.mujoco import sliding

    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    assert sliding.native(), "install the package again (make setup)"


@pytest.mark.parametrize("preset", ["faithful", "fast"])
def test_steps_in_c_and_in_python_are_the_same_to_the_bit(tmp_path: Path, preset: Preset, callback: None) -> None:
    native_or_skip()
    in_c = slide(World("mujoco", DT, preset), tmp_path)
    mujoco.set_mjcb_control(None)
    assert slide(World("mujoco", DT, preset), tmp_path) == in_c


def test_a_callback_of_other_code_stays_and_python_corrects(tmp_path: Path, callback: None) -> None:
    expected = slide(World("mujoco", DT), tmp_path)
    called: list[None] = []
    other = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(lambda model, data: called.append(None))
    mujoco.set_mjcb_control(other)
    assert slide(World("mujoco", DT), tmp_path) == expected and called


def test_models_of_other_code_are_left_alone(callback: None) -> None:
    native_or_skip()
    model = mujoco.MjModel.from_xml_string(
        '''<mujoco><option cone="elliptic"/><custom><numeric name="other" data="1"/></custom><worldbody>
        <geom type="plane" size="1 1 1"/><body pos="0 0 .05"><freejoint/><geom type="box" size=".05 .05 .05"/></body>
        </worldbody></mujoco>'''
    )
    ends = []
    for function in (mujoco.get_mjcb_control(), None):
        mujoco.set_mjcb_control(function)
        data = mujoco.MjData(model)
        data.qvel[0] = 1.0
        mujoco.mj_step(model, data, nstep=50)
        ends.append(data.qpos.tolist())
    assert ends[0] == ends[1] and ends[0][0] > 0.01


def test_threads_step_worlds_side_by_side_as_one_after_the_other(tmp_path: Path) -> None:
    expected = slide(World("mujoco", DT), tmp_path)
    with ThreadPoolExecutor(4) as threads:
        folders = [tmp_path / str(i) for i in range(4)]
        for folder in folders:
            folder.mkdir()
        assert list(threads.map(lambda folder: slide(World("mujoco", DT), folder), folders)) == [expected] * 4
