"""Joint limits from the table and from labels, for both hands."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dgrasp.errors import DataError
from dgrasp.hand.builder.limits import LABEL_SLACK, label_limits, mirror_limits, table_limits
from dgrasp.hand.free.anatomy import hand_parts
from dgrasp.hand.mano.skeleton import DOF_NAMES
from dgrasp.hand.store import open_hand
from dgrasp.labels.load import load_labels
from dgrasp.types import Array
from tests.reference import reference_or_skip
from tests.scenes import free_hand, make_label


def straight_hand() -> tuple[Array, Array]:
    """Joints (16, 3) and tips (5, 3) of a hand whose fingers all point along -x."""
    joints, tips = np.zeros((16, 3)), np.zeros((5, 3))
    for f in range(5):
        joints[1 + 3 * f : 4 + 3 * f] = [[-0.09 - 0.03 * s, 0.0, 0.02 * f] for s in range(3)]
        tips[f] = [-0.18, 0.0, 0.02 * f]
    return joints, tips


def test_table_of_straight_fingers_is_the_norms_with_slack() -> None:
    degrees = np.degrees(table_limits(*straight_hand()))
    for f in range(4):
        # Flexion of 90, 100 and 80 degrees about z, extension of 20, 0 and 5; 10 degrees of slack on both sides.
        assert degrees[9 * f + 2 :: 3][:3] == pytest.approx(np.array([[-30, 100], [-10, 110], [-15, 90]]))
        assert degrees[9 * f + 1] == pytest.approx([-30, 30]) and degrees[9 * f] == pytest.approx([-15, 15])


def test_table_of_the_free_hands_thumb_is_its_own() -> None:
    _, keypoints = free_hand().forward(np.zeros((1, 51)), np.eye(3)[None], np.zeros((1, 3)))
    points = keypoints[0]
    joints = np.vstack([points[:1], *(points[1 + 4 * f : 4 + 4 * f] for f in range(5))])
    ours = table_limits(joints, points[4::4])
    assert ours[36:] == pytest.approx(np.concatenate([part.limits for part in hand_parts()[13:]]), abs=1e-4)


def test_a_finger_that_points_aside_bends_about_another_axis() -> None:
    joints, tips = straight_hand()
    # The little finger turned by 90 degrees towards -z: it bends about -x.
    joints[10:13] = [[-0.07, 0.0, -0.04 - 0.02 * s] for s in range(3)]
    tips[3] = [-0.07, 0.0, -0.1]
    limits = np.degrees(table_limits(joints, tips))[27:36].reshape(3, 3, 2)
    assert limits[0, 0] == pytest.approx([-100, 30]) and limits[0, 2] == pytest.approx([-15, 15])
    tips[0] = joints[3]
    with pytest.raises(DataError, match="index finger is shorter"):
        table_limits(joints, tips)


def test_range_of_labels() -> None:
    hand = free_hand()
    labels = [make_label(hand, flexion=0.2), make_label(hand, flexion=0.7)]
    labels[1] = dataclasses.replace(labels[1], start=None)
    limits = label_limits(labels)
    flexions = [i for i, name in enumerate(DOF_NAMES[6:]) if name.endswith("rz")]
    # The first label's start is the flat hand.
    assert limits[flexions] == pytest.approx(np.tile([-LABEL_SLACK, 0.7 + LABEL_SLACK], (15, 1)))
    with pytest.raises(DataError, match="no labels"):
        label_limits([])


def test_limits_of_the_other_hand() -> None:
    limits = np.sort(np.random.default_rng(0).normal(size=(45, 2)), axis=1)
    other = mirror_limits(limits)
    assert np.array_equal(mirror_limits(other), limits)
    assert np.array_equal(other[0], limits[0]) and np.array_equal(other[2], -limits[2, ::-1])


def test_table_holds_measured_grasps() -> None:
    root = reference_or_skip()
    model = open_hand(str(root / "hand" / "mano_mean.urdf")).model
    _, keypoints = model.forward(np.zeros((1, 51)), np.eye(3)[None], np.zeros((1, 3)))
    points = keypoints[0]
    joints = np.vstack([points[:1], *(points[1 + 4 * f : 4 + 4 * f] for f in range(5))])
    table = table_limits(joints, points[4::4])
    labels = load_labels(root / "labels" / "dexycb_train_labels.pkl").labels
    poses = np.stack([label.hand_pose for label in labels])
    inside = (poses >= table[:, 0]) & (poses <= table[:, 1])
    assert inside.mean() > 0.95 and inside[:, :36].mean() > 0.98
    span = label_limits(labels)
    assert ((poses > span[:, 0]) & (poses < span[:, 1])).all()
