"""Labels in the mirror: twice is the label again, and kinematics mirrors with them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.hand.model import HandModel
from dgrasp.labels.recorded.mirror import mirror_label
from dgrasp.types import Array, GraspLabel, StartPose
from raisim_like.rotations import transform
from tests.scenes import free_hand, mirrored

WORLD = np.diag([1.0, -1.0, 1.0])


def random_label(seed: int) -> GraspLabel:
    rng = np.random.default_rng(seed)

    def pose() -> Array:
        return transform(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))

    hand_pose, T_WH = rng.uniform(-1, 1, 45), pose()
    start = StartPose(pose(), pose(), rng.uniform(-1, 1, 45))
    joints = key_points(free_hand(), T_WH, hand_pose)
    return GraspLabel("025_mug", hand_pose, T_WH, pose(), joints, rng.random(16) < 0.5, start, "free", "test", seed)


def key_points(hand: HandModel, T_WH: Array, hand_pose: Array) -> Array:
    gc = np.zeros((1, 51))
    gc[0, 6:] = hand_pose
    return hand.forward(gc, T_WH[None, :3, :3], T_WH[None, :3, 3])[1][0]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_twice_is_the_label_again(axis: int) -> None:
    label = random_label(1)
    once = mirror_label(label, object_axis=axis)
    twice = mirror_label(once, object_axis=axis)
    assert (once.hand, twice.hand) == ("free_mirrored", "free")
    for name in ("hand_pose", "T_WH", "T_WO", "joints_W", "goal_contacts"):
        assert np.array_equal(getattr(twice, name), getattr(label, name)), name
    assert once.start is not None and twice.start is not None and label.start is not None
    for name in ("T_WH", "T_WO", "hand_pose"):
        assert np.array_equal(getattr(twice.start, name), getattr(label.start, name)), name
    for T in (once.T_WH, once.T_WO, once.start.T_WH, once.start.T_WO):
        assert np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() < 1e-12 and np.linalg.det(T[:3, :3]) > 0.99


def test_kinematics_mirrors_with_the_label() -> None:
    hand = free_hand()
    for seed in range(5):
        label = random_label(seed)
        once = mirror_label(label)
        found = key_points(mirrored(hand), once.T_WH, once.hand_pose)
        assert np.abs(found - label.joints_W @ WORLD).max() < 1e-12
        assert np.abs(found - once.joints_W).max() < 1e-12


def test_points_of_a_symmetric_object_stay_on_it() -> None:
    label = random_label(3)
    for axis in range(3):
        once = mirror_label(label, object_axis=axis)
        corner = np.array([0.03, 0.05, 0.1])
        image = corner * np.where(np.arange(3) == axis, -1.0, 1.0)
        world = label.T_WO[:3, :3] @ corner + label.T_WO[:3, 3]
        assert once.T_WO[:3, :3] @ image + once.T_WO[:3, 3] == pytest.approx(WORLD @ world, abs=1e-12)


def test_what_stays_and_what_may_be_named() -> None:
    label = dataclasses.replace(random_label(4), start=None)
    once = mirror_label(label, hand="mano_left-0123456789ab")
    assert once.hand == "mano_left-0123456789ab" and once.start is None
    assert (once.object_id, once.source, once.index, once.on_table) == (label.object_id, "test", 4, True)
    # The table stays where it is: x and z of every position are the same.
    assert np.array_equal(once.T_WO[[0, 2], 3], label.T_WO[[0, 2], 3]) and once.T_WO[1, 3] == -label.T_WO[1, 3]
