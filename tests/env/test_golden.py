"""Features, reward and PD target against states and numbers computed independently from the authors' release."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dgrasp.config.sections import ActionConfig, EnvConfig, RewardConfig
from dgrasp.control.controllers import WristGuidance
from dgrasp.env.features import FeatureLayer
from dgrasp.env.goal import make_goal
from dgrasp.env.rewards import Reward
from dgrasp.hand.load import load_hand
from dgrasp.hand.model import HandModel
from dgrasp.scene.relations import relations
from dgrasp.scene.state import state_views
from dgrasp.types import GraspGoal, GraspLabel, SceneState
from raisim_like.rotations import matrix_from_euler, matrix_from_quaternion, transform
from tests.reference import reference_or_skip
from tests.scenes import LAYOUT


@pytest.fixture(scope="module")
def golden() -> dict[str, Any]:
    with np.load(reference_or_skip() / "golden" / "observation_reward.npz") as file:
        return dict(file)


@pytest.fixture(scope="module")
def reference_hand() -> HandModel:
    return load_hand(reference_or_skip() / "hand" / "mano_mean.urdf", "mano_mean", weight_carried=False, mano=True)


@pytest.fixture(scope="module")
def goal(golden: dict[str, Any]) -> GraspGoal:
    labels = []
    for i in golden["label"]:
        qpos, pose = golden["label_final_qpos"][i], golden["label_final_obj_pos"][i]
        labels.append(GraspLabel(
            object_id="", hand_pose=qpos[6:], T_WH=transform(matrix_from_euler(qpos[3:6]), qpos[:3]),
            T_WO=transform(matrix_from_quaternion(pose[3:]), pose[:3]),
            joints_W=golden["label_final_ee"][i].reshape(21, 3), goal_contacts=golden["label_final_contacts"][i] > 0,
            start=None, hand="mano_mean", source="golden", index=int(i),
        ))
    return make_goal(labels)


@pytest.fixture(scope="module")
def state(golden: dict[str, Any]) -> SceneState:
    label = golden["label"]
    s = state_views(len(label), LAYOUT)
    start = golden["label_qpos_reset"][label]
    s.R_WH0[:], s.wrist_start_W[:] = matrix_from_euler(start[:, 3:6]), start[:, :3]
    s.object_start_W[:] = golden["label_obj_pose_reset"][label, :3]
    s.object_mass[:] = golden["label_object_mass"][label]
    s.table_height_W[:] = 0.5
    s.gc[:], s.gv[:] = golden["gc"], golden["gv"]
    s.R_WH[:], s.joints_W[:] = golden["R_WH"], golden["joints_W"]
    s.R_WO[:], s.object_pos_W[:] = golden["R_WO"], golden["object_pos"]
    s.object_linvel_W[:], s.object_angvel_W[:] = golden["object_linvel_W"], golden["object_angvel_W"]
    s.contacts[:], s.contact_impulse[:] = golden["contacts"], golden["impulses"]
    return s


def test_key_points_of_the_states(golden: dict[str, Any], state: SceneState, reference_hand: HandModel) -> None:
    R, joints = reference_hand.forward(golden["gc"], state.R_WH0, state.wrist_start_W)
    assert np.abs(joints - golden["joints_W"]).max() < 1e-6
    assert np.abs(R - golden["R_WH"]).max() < 1e-6


@pytest.mark.parametrize("block", [feature.name for feature in FeatureLayer(EnvConfig(), LAYOUT).features])
def test_observations(golden: dict[str, Any], state: SceneState, goal: GraspGoal, block: str) -> None:
    layer = FeatureLayer(EnvConfig(), LAYOUT)
    observation = np.zeros((len(state.gc), layer.size))
    layer(state, goal, relations(state, goal), observation)
    part = layer.slices[block]
    assert np.abs(observation[:, part] - golden["obs"][:, part]).max() < 1e-5
    assert np.abs(golden["obs"][:, part]).max() > 1e-3


def test_rewards(golden: dict[str, Any], state: SceneState, goal: GraspGoal) -> None:
    reward = Reward(RewardConfig(), LAYOUT)
    terms, total = np.zeros((len(state.gc), len(reward.names))), np.zeros(len(state.gc))
    reward(state, goal, relations(state, goal), terms, total)
    assert np.abs(total - golden["reward"]).max() < 1e-5
    assert np.ptp(golden["reward"]) > 1.0


def test_pd_targets(
    golden: dict[str, Any], state: SceneState, goal: GraspGoal, reference_hand: HandModel
) -> None:
    controller = WristGuidance(ActionConfig(), LAYOUT)
    target = np.zeros((len(state.gc), 51))
    controller.bias(state, goal, target)
    target += controller.sigma * golden["action"]
    target = np.clip(target, *reference_hand.limits.T)
    assert np.abs(target - golden["pd_target"]).max() < 1e-6


def test_joint_limits(golden: dict[str, Any], reference_hand: HandModel) -> None:
    assert np.abs(reference_hand.limits - golden["joint_limits"]).max() < 1e-9
