from __future__ import annotations

import numpy as np
import pytest

from dgrasp.hand.inverse import STAY, _Chains, fit_keypoints
from dgrasp.hand.model import HandModel
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_euler
from tests.scenes import free_hand


@pytest.fixture(scope="module")
def hand() -> HandModel:
    return free_hand()


def poses(hand: HandModel, n: int, seed: int) -> tuple[Array, Array]:
    """Wrists (n, 4, 4) and angles (n, 45) in the middle half of the limits."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = matrix_from_euler(rng.uniform(-1.2, 1.2, (n, 3)))
    T[:, :3, 3] = rng.uniform(-0.3, 0.3, (n, 3))
    low, high = hand.limits[6:].T
    return T, low + (high - low) * rng.uniform(0.25, 0.75, (n, 45))


def keypoints(hand: HandModel, T: Array, pose: Array) -> Array:
    gc = np.zeros((len(pose), 51))
    gc[:, 6:] = pose
    return hand.forward(gc, T[:, :3, :3], T[:, :3, 3])[1]


def test_chains_are_the_hands_kinematics(hand: HandModel) -> None:
    T, pose = poses(hand, 5, 0)
    assert np.abs(_Chains(hand, T[:, :3, :3], T[:, :3, 3], pose).joints - keypoints(hand, T, pose)).max() < 1e-12


def test_jacobian_against_differences(hand: HandModel) -> None:
    T, pose = poses(hand, 3, 1)
    chains = _Chains(hand, T[:, :3, :3], T[:, :3, 3], pose)
    J, h = chains.jacobian(), 1e-6
    bounds = np.full((3, 45), -9.0), np.full((3, 45), 9.0)
    for k in range(51):
        step = np.zeros((3, 51))
        step[:, k] = h
        slope = (chains.moved(step, *bounds).joints - chains.moved(-step, *bounds).joints) / (2 * h)
        assert np.abs(J[..., k] - slope).max() < 1e-7, k


def test_it_finds_a_hand_from_its_key_points(hand: HandModel) -> None:
    T, pose = poses(hand, 8, 2)
    rng = np.random.default_rng(5)
    start = T.copy()
    start[:, :3, 3] += rng.uniform(-0.01, 0.01, (8, 3))
    start[:, :3, :3] = start[:, :3, :3] @ matrix_from_euler(rng.uniform(-0.1, 0.1, (8, 3)))
    targets = keypoints(hand, T, pose)
    fit = fit_keypoints(hand, start, np.clip(pose + rng.uniform(-0.2, 0.2, pose.shape), *hand.limits[6:].T), targets)
    off = np.linalg.norm(fit.joints - targets, axis=2)
    assert off.mean() < 4e-4 and off.max() < 2e-3
    assert np.abs(fit.T_AH[:, :3, 3] - T[:, :3, 3]).max() < 2e-3
    assert np.abs(keypoints(hand, fit.T_AH, fit.hand_pose) - fit.joints).max() < 1e-12


def test_a_hand_that_is_there_already_stays(hand: HandModel) -> None:
    T, pose = poses(hand, 2, 3)
    fit = fit_keypoints(hand, T, pose, keypoints(hand, T, pose))
    assert np.abs(fit.hand_pose - pose).max() < 1e-9 and np.abs(fit.T_AH - T).max() < 1e-9


def test_a_shift_of_all_targets_moves_the_wrist_alone(hand: HandModel) -> None:
    T, pose = poses(hand, 2, 4)
    shift = np.array([0.02, -0.01, 0.005])
    fit = fit_keypoints(hand, T, pose, keypoints(hand, T, pose) + shift)
    assert fit.T_AH[:, :3, 3] - T[:, :3, 3] == pytest.approx(np.tile(shift, (2, 1)), abs=1e-6)
    assert np.abs(fit.hand_pose - pose).max() < 1e-4


def test_angles_keep_the_limits_or_where_they_began(hand: HandModel) -> None:
    T, pose = poses(hand, 1, 6)
    pose[0, 2] = hand.limits[8, 1] + 0.3
    targets = keypoints(hand, T, pose)
    # Fingertips pulled far through the back of the hand.
    targets[:, 4::4] += 0.1 * T[:, None, :3, 1]
    fit = fit_keypoints(hand, T, pose, targets)
    low, high = np.minimum(hand.limits[6:, 0], pose[0]), np.maximum(hand.limits[6:, 1], pose[0])
    assert (fit.hand_pose[0] >= low).all() and (fit.hand_pose[0] <= high).all()
    assert ((fit.hand_pose[0] <= low + 1e-12) | (fit.hand_pose[0] >= high - 1e-12)).any()


def test_rows_do_not_depend_on_each_other_and_the_fit_gains(hand: HandModel) -> None:
    T, pose = poses(hand, 4, 7)
    targets = keypoints(hand, T, pose)
    targets[:, 4::4] += np.random.default_rng(8).uniform(-0.01, 0.01, (4, 5, 3))
    together = fit_keypoints(hand, T, pose, targets)
    alone = fit_keypoints(hand, T[2:3], pose[2:3], targets[2:3])
    assert together.hand_pose[2] == pytest.approx(alone.hand_pose[0], abs=1e-9)
    before = ((keypoints(hand, T, pose) - targets) ** 2).sum(axis=(1, 2))
    after = ((together.joints - targets) ** 2).sum(axis=(1, 2)) + (STAY**2 * (together.hand_pose - pose) ** 2).sum(1)
    assert (after < 0.5 * before).all()
