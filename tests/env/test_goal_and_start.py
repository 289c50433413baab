"""Goals relative to the object, and starts for labels without one."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgrasp.env.goal import make_goal
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.env.start import APPROACH_DISTANCE, start_pose
from dgrasp.hand.load import load_hand
from dgrasp.scene.scene import TABLE
from raisim_like.rotations import matrix_from_euler, transform
from raisim_like.world import STATIC, SYSTEM
from tests.env.build import moved_label, random_labels, random_rotations
from tests.scenes import free_hand, make_spec


def test_goals_are_relative_to_the_object() -> None:
    labels = random_labels(4)
    rng = np.random.default_rng(2)
    moved = [moved_label(one, transform(random_rotations(1, rng)[0], rng.normal(size=3))) for one in labels]
    first, second = make_goal(labels), make_goal(moved)
    assert np.abs(first.joints_O - second.joints_O).max() < 1e-12
    assert np.abs(first.R_OH - second.R_OH).max() < 1e-12
    assert np.abs(first.wrist_euler_O - second.wrist_euler_O).max() < 1e-12
    assert np.array_equal(first.hand_pose, second.hand_pose)
    assert np.array_equal(first.goal_contacts, second.goal_contacts)


def test_with_the_object_in_the_worlds_frame_goals_are_the_labels_numbers() -> None:
    (one,) = random_labels(1)
    goal = make_goal([replace(one, T_WO=np.eye(4))])
    assert goal.joints_O.tolist() == [one.joints_W.tolist()]
    assert np.array_equal(goal.R_OH[0], one.T_WH[:3, :3])
    assert np.abs(matrix_from_euler(goal.wrist_euler_O)[0] - one.T_WH[:3, :3]).max() < 1e-12
    assert goal.goal_contacts.dtype == np.float64
    assert goal.goal_contacts[0].tolist() == one.goal_contacts.astype(float).tolist()


def test_a_label_keeps_its_own_start() -> None:
    (one,) = random_labels(1)
    assert start_pose(one, free_hand()) is one.start


def test_without_a_start_the_wrist_is_drawn_back_from_the_object() -> None:
    for one in random_labels(4):
        start = start_pose(replace(one, start=None), free_hand())
        away = one.T_WH[:3, 3] - one.T_WO[:3, 3]
        drawn = start.T_WH[:3, 3] - one.T_WH[:3, 3]
        assert np.allclose(drawn, APPROACH_DISTANCE * away / np.linalg.norm(away), atol=1e-12)
        assert np.array_equal(start.T_WH[:3, :3], one.T_WH[:3, :3])
        assert np.array_equal(start.T_WO, one.T_WO)
        # The fingers of a hand at rest are all bent, and within the limits.
        flexion = start.hand_pose.reshape(15, 3)[:12, 2]
        assert flexion.min() > 0.05 and flexion.max() < 1.0
        low, high = free_hand().limits[6:].T
        assert (start.hand_pose >= low).all() and (start.hand_pose <= high).all()


def test_a_left_hand_at_rest_is_the_mirror_image(tmp_path: Path) -> None:
    wide = re.sub(r'lower="[^"]*" upper="[^"]*"', 'lower="-3" upper="3"', free_hand().urdf.path.read_text("utf-8"))
    (tmp_path / "wide.urdf").write_text(wide, encoding="utf-8")
    right, left = (load_hand(tmp_path / "wide.urdf", "wide", side).rest.reshape(15, 3) for side in ("right", "left"))
    assert np.abs(right).max() > 0.1 and np.array_equal(left, right * [1, -1, -1])


def test_a_wrist_in_the_objects_centre_goes_up() -> None:
    (one,) = random_labels(1)
    inside = replace(one, T_WH=one.T_WO.copy(), start=None)
    start = start_pose(inside, free_hand())
    assert np.allclose(start.T_WH[:3, 3] - one.T_WO[:3, 3], [0, 0, APPROACH_DISTANCE], atol=1e-15)
    # The label itself is not changed.
    assert np.array_equal(inside.T_WH, one.T_WO)


def test_the_table_stops_the_hand_of_labels_alone_that_know_it() -> None:
    """Grasps of synthesis methods may come from below the surface (supplement, B.5)."""
    spec = make_spec(2, [])
    labels = [spec.labels[0], replace(spec.labels[1], on_table=False)]
    env = GraspEnv(labels, spec.hand, spec.objects, spec.config)
    env.close()
    meets_table = [bool(world.systems[0].mask >> 8 & STATIC) for world in env.worlds.specs]
    met_by_table = [bool(world.bodies[TABLE].mask >> 8 & SYSTEM) for world in env.worlds.specs]
    assert meets_table == met_by_table == [True, False] and spec.config.physics.hand_table_collision
