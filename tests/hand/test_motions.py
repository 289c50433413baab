"""Anatomical motions of a hand and the prior of natural ones."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.hand.mano.skeleton import PARTS
from dgrasp.hand.motions import MANO_MOTIONS, hand_motions
from tests.scenes import free_hand, mirrored


def test_motions_bend_fingers_about_their_axes() -> None:
    hand = free_hand()
    motions = hand_motions(hand)
    assert motions.to_pose.shape == (len(MANO_MOTIONS), 45) == (21, 45)
    # The middle finger, which points along -x, flexes about z of its three joints, and its pads face -y like the palm.
    for name, joint in (("middle_proximal", 11), ("middle_middle", 14), ("middle_distal", 17)):
        expected = np.zeros(45)
        expected[joint] = 1.0
        assert motions.to_pose[MANO_MOTIONS.index(name)] == pytest.approx(expected, abs=1e-6)
    for part in ("palm", "middle_proximal", "middle_distal"):
        assert motions.palmar[PARTS.index(part)] == pytest.approx([0.0, -1.0, 0.0], abs=0.01)
    assert np.linalg.norm(motions.palmar, axis=1) == pytest.approx(np.ones(16))
    assert motions.whiten @ motions.factor == pytest.approx(np.eye(21), abs=1e-9)
    # The mean hand is within its limits.
    pose = motions.mean @ motions.to_pose
    assert (pose >= hand.limits[6:, 0]).all() and (pose <= hand.limits[6:, 1]).all()


def test_fingers_of_the_prior_bend_alike() -> None:
    factor = hand_motions(free_hand()).factor
    covariance = factor @ factor.T
    spread = np.sqrt(np.diag(covariance))
    index, ring, middle, distal = (MANO_MOTIONS.index(k) for k in ("index_middle", "ring_middle", "middle_middle",
                                                              "index_distal"))  # fmt: skip
    correlation = covariance / np.outer(spread, spread)
    assert correlation[index, middle] == pytest.approx(0.75) and correlation[index, ring] == pytest.approx(0.75**2)
    # The distal joint has two thirds of the middle one's 20 degrees, and 6 of its own.
    assert np.degrees(spread[distal]) == pytest.approx(np.hypot(40 / 3, 6.0))


def test_a_left_hand_is_the_mirror_image() -> None:
    hand, mirror = free_hand(), np.array([-1.0, 1.0, 1.0])
    left = mirrored(hand)
    right, motions = hand_motions(hand), hand_motions(left)
    assert motions.palmar == pytest.approx(right.palmar * mirror, abs=1e-12)
    assert motions.to_pose == pytest.approx(right.to_pose * np.tile([1.0, -1.0, -1.0], 15), abs=1e-12)
