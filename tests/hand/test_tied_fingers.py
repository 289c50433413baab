"""A hand whose outer joints follow others: poses, inverse kinematics, made grasps, labels, and the environment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from dgrasp.config.experiment import load_config
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.hand.inverse import fit_keypoints
from dgrasp.hand.load import load_hand
from dgrasp.hand.model import HandModel
from dgrasp.hand.surface import rigid_surface
from dgrasp.labels.quality.measure import measure_labels
from dgrasp.objects.free import free_object
from dgrasp.synthesis.energy import let_yield
from dgrasp.synthesis.start import propose, rest_poses
from dgrasp.synthesis.synthesiser import make_setting
from dgrasp.synthesis.torch_hand import TorchHand
from dgrasp.types import GraspLabel
from raisim_like.rotations import transform
from tests.hand.three_fingers import write_tied_fingers

BRICK = "061_foam_brick"


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> HandModel:
    path = write_tied_fingers(tmp_path_factory.mktemp("hand") / "three.urdf")
    return load_hand(path, "three", side=None)


def make_label(hand: HandModel, pose: list[float]) -> GraspLabel:
    """A hand above a brick."""
    T_WH, T_WO = transform(np.eye(3), np.array([0.5, 0.2, 0.8])), transform(np.eye(3), np.array([0.5, 0.2, 0.53]))
    joints = hand.keypoints_at(T_WH[None], np.array([pose]))[0]
    return GraspLabel(BRICK, np.array(pose), T_WH, T_WO, joints, np.zeros(7, bool), None, "three", "test", 0)


def test_ties_limits_and_rest(hand: HandModel) -> None:
    """With q = 0.9 q_before + 0.1, long_2 is 0.81 long_0 + 0.19; long_1 within 1.6 needs long_0 below 1.5 / 0.9."""
    assert hand.ties.followers.tolist() == [1, 2, 4] and hand.ties.free.tolist() == [0, 3, 5]
    assert hand.ties.coordinates(np.array([1.0, 9, 9, 0.0, 9, 0.5])) == pytest.approx([1.0, 1.0, 1.0, 0.0, 0.1, 0.5])
    assert hand.limits[6:] == pytest.approx(np.array(
        [[-0.1, 1.6], [0.01, 1.54], [0.109, 1.486], [-0.1, 1.6], [0.01, 1.54], [-0.3, 0.9]]
    ))  # fmt: skip
    assert hand.rest == pytest.approx([0.0, 0.1, 0.19, 0.0, 0.1, 0.0])


def test_inverse_kinematics_move_tied_joints_together(hand: HandModel) -> None:
    rng = np.random.default_rng(4)
    pose = hand.ties.coordinates(rng.uniform(0.2, 0.8, (3, 6)))
    T = np.tile(transform(np.eye(3), np.array([0.1, 0.2, 0.3])), (3, 1, 1))
    fit = fit_keypoints(hand, T, pose + rng.uniform(-0.15, 0.15, (3, 6)), hand.keypoints_at(T, pose))
    assert fit.hand_pose == pytest.approx(hand.ties.coordinates(fit.hand_pose), abs=1e-12)
    assert fit.hand_pose == pytest.approx(pose, abs=0.05)
    assert np.linalg.norm(fit.joints - hand.keypoints_at(T, pose), axis=2).max() < 0.002


def test_made_grasps_are_tied_and_only_motors_yield(hand: HandModel) -> None:
    torch_hand, setting = TorchHand(hand), make_setting(free_object(BRICK, "official", True))
    rng = np.random.default_rng(0)
    grasps = propose(torch_hand, setting, rest_poses(setting, rng, 3), rng)
    grasps = let_yield(torch_hand, setting.field, grasps, rng)
    pose = grasps.pose(torch_hand).numpy().astype(float)
    assert pose == pytest.approx(hand.ties.coordinates(pose), abs=1e-6)
    assert grasps.yields.any() and not grasps.yields[:, torch.as_tensor(hand.ties.followers)].any()
    assert np.ptp(pose, axis=0).min() > 0.05


def test_a_label_whose_pose_is_not_tied_is_reported(hand: HandModel) -> None:
    brick = make_setting(free_object(BRICK, "official", True)).body
    poses = [0.5, 0.55, 0.595, 0.2, 0.28, 0.0], [0.5, 0.65, 0.595, 0.2, 0.28, 0.0]
    labels = [make_label(hand, pose) for pose in poses]
    good, bad = measure_labels(labels, hand, rigid_surface(hand), {BRICK: brick})
    # long_1 is 0.1 rad from what long_0 says.
    assert (good.beyond_limits, bad.beyond_limits) == (0, 1)
    assert bad.limit_excess_deg == pytest.approx(np.degrees(0.1))


def test_actions_of_following_joints_have_no_effect(hand: HandModel, engine: str) -> None:
    """An environment starts tied, whatever the label says, and stays so."""
    config = load_config(None, [f"engine={engine}"])
    label = make_label(hand, [0.5, 0.0, 0.0, 0.5, 0.0, 0.5])
    env = GraspEnv([label, replace(label, index=1)], hand, {BRICK: free_object(BRICK, "official", True)}, config)
    assert env.action_size == 12
    env.reset(mode="test")
    follows = 6 + hand.ties.followers
    actions = np.ones((2, 12))
    actions[1, follows] = -3.0
    for _ in range(10):
        env.step(actions)
        gc = env.s.gc[:, 6:]
        assert gc == pytest.approx(hand.ties.coordinates(gc), abs=1e-5)
    assert np.array_equal(env.s.gc[0], env.s.gc[1]) and env.s.gc[0, 6] > hand.rest[0] + 0.05
    env.close()
