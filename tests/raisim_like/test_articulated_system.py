"""Articulated systems: frames, base, limits, and vectors of the wrong shape."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from raisim_like import ArticulatedSystem, UrdfError, World
from tests.raisim_like.test_urdf import ARM, read
from tests.raisim_like.urdfs import link_poses, write_chain

Q = np.array([0.7, 0.4, -1.1])


@pytest.fixture
def world(engine: str) -> Iterator[World]:
    made = World(engine)
    yield made
    made.close()


@pytest.fixture
def arm(world: World, tmp_path: Path) -> ArticulatedSystem:
    return world.add_articulated_system(read(tmp_path, ARM))


def test_frames_follow_the_joints_and_the_base(arm: ArticulatedSystem) -> None:
    base = Rotation.from_rotvec([0.2, 0.5, -0.8])
    arm.set_base_pose((0.1, 0.2, 0.3), base.as_quat()[[3, 0, 1, 2]])
    arm.set_state(Q)
    poses = link_poses(arm.model, Q)
    for name in ("empty", "arm", "tool", "mark", "side"):
        index, local = arm.model.frames[name]
        T = poses[index] @ local
        R, t = arm.frame_pose(name)
        # The engine reports link frames in single precision.
        assert np.abs(R - base.as_matrix() @ T[:3, :3]).max() < 5e-7
        assert np.abs(t - base.apply(T[:3, 3]) - [0.1, 0.2, 0.3]).max() < 2e-6


def test_unknown_and_fixed_frames_are_refused(arm: ArticulatedSystem) -> None:
    with pytest.raises(ValueError, match=r"no link 'finger'; it has .*'tool'"):
        arm.frame_pose("finger")
    with pytest.raises(ValueError, match="part of the fixed base"):
        arm.frame_pose("mount")


def test_state_and_limits(arm: ArticulatedSystem) -> None:
    assert arm.dof == 3
    assert arm.joint_limits.tolist() == arm.model.joint_limits.tolist()
    arm.set_state(Q, [1.0, 2.0, 3.0])
    assert arm.generalized_coordinate.tolist() == Q.tolist()
    assert arm.generalized_velocity.tolist() == [1.0, 2.0, 3.0]
    arm.set_state(Q)
    assert arm.generalized_velocity.tolist() == [0.0, 0.0, 0.0]


def test_coordinates_are_those_that_bullet_has(world: World, tmp_path: Path) -> None:
    """The coordinates come from the controller, the frames from the engine."""
    chain = world.add_articulated_system(write_chain(tmp_path / "chain.urdf", 3, limit=0.4))
    chain.set_pd_gains(20, 0.1)
    chain.set_pd_target([2.0, -0.3, 0.1])
    world.integrate(130)
    poses = link_poses(chain.model, chain.generalized_coordinate)
    R, t = chain.frame_pose("link2")
    assert np.abs(poses[2][:3, :3] - R).max() < 5e-7 and np.abs(poses[2][:3, 3] - t).max() < 5e-7


def test_returned_arrays_are_copies(arm: ArticulatedSystem) -> None:
    arm.set_state(Q)
    arm.generalized_coordinate[:] = 9.0
    assert arm.generalized_coordinate.tolist() == Q.tolist()


@pytest.mark.parametrize("method", ["set_state", "set_pd_target", "set_generalized_force"])
def test_vectors_of_the_wrong_shape_or_content_are_refused(arm: ArticulatedSystem, method: str) -> None:
    with pytest.raises(ValueError, match=r"expected shape \(3,\), got \(2,\)"):
        getattr(arm, method)([0.0, 1.0])
    with pytest.raises(ValueError, match="not finite"):
        getattr(arm, method)([0.0, np.nan, 1.0])


def test_gains_may_be_one_number(arm: ArticulatedSystem) -> None:
    arm.set_pd_gains(10.0, [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="kd: expected shape"):
        arm.set_pd_gains(10.0, [1.0, 2.0])


def test_without_gains_a_system_just_falls(world: World, arm: ArticulatedSystem) -> None:
    """The slide carries all 8 kg and falls freely; PyBullet's default motors would hold it."""
    arm.set_state([1.5, 0.0, 0.0])
    world.integrate(1)
    assert arm.generalized_velocity[0] == pytest.approx(-9.81 * world.timestep, rel=0.05)


def test_siblings_collide_only_where_asked(world: World, tmp_path: Path) -> None:
    """Two arms on one base whose balls overlap."""
    arm = (
        '<link name="{0}"><inertial><mass value="1"/></inertial><collision><geometry><sphere radius="0.05"/></geometry>'
        '</collision></link><joint name="j{0}" type="revolute"><parent link="base"/><child link="{0}"/></joint>'
    )
    path = tmp_path / "pair.urdf"
    path.write_text(f'<robot name="pair"><link name="base"/>{arm.format("left")}{arm.format("right")}</robot>')
    touching = []
    for self_collision in (False, True):
        pair = world.add_articulated_system(path, self_collision=self_collision)
        world.integrate(1)
        touching.append(any(c.body_a == c.body_b for c in pair.contacts()))
        world.remove(pair)
    assert touching == [False, True]


def test_a_file_that_is_not_there_is_the_readers_error(world: World, tmp_path: Path) -> None:
    with pytest.raises(UrdfError, match="absent"):
        world.add_articulated_system(tmp_path / "absent.urdf")


def test_a_slider_can_leave_its_limits_to_its_targets_too(world: World, tmp_path: Path) -> None:
    file = tmp_path / "slider.urdf"
    file.write_text(
        '<robot name="slider"><link name="base"/><link name="cart"><inertial><mass value="1"/></inertial></link>'
        '<joint name="z" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="0 0 1"/>'
        '<limit lower="-0.1" upper="0.1"/></joint></robot>', encoding="utf-8",
    )  # fmt: skip
    world.set_gravity((0, 0, -9.81))
    system = world.add_articulated_system(file, enforce_limits=False)
    world.integrate(100)
    # Semi-implicit Euler falls by g dt^2 n (n + 1) / 2.
    assert system.generalized_coordinate[0] == pytest.approx(-9.81 * world.timestep**2 * 100 * 101 / 2, rel=1e-3)
