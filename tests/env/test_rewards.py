"""Every term of the reward, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.config.sections import RewardConfig
from dgrasp.env.rewards import TERMS, Parameters, Reward, keypoint_weights
from dgrasp.hand.mano.skeleton import TIPS
from dgrasp.scene.relations import Relations
from dgrasp.scene.state import state_views
from dgrasp.types import Array, GraspGoal, SceneState
from tests.scenes import LAYOUT

TIP_WEIGHT, JOINT_WEIGHT = 4 * 21 / 36, 21 / 36  # 16 joints and 5 tips that count 4 times: sum 36, mean 1.


def tiny() -> tuple[SceneState, GraspGoal, Relations]:
    """Two states: one with a round number in every term, one at rest at its goal."""
    s = state_views(2, LAYOUT)
    s.contacts[0, [1, 2, 7]] = 1.0
    s.contact_impulse[0, [1, 2, 7]] = 0.02, 0.03, 0.5
    s.object_mass[:] = 0.4
    s.object_linvel_W[0], s.object_angvel_W[0] = (1.0, 2.0, -2.0), (0.0, 3.0, 4.0)
    s.gv[0, :6] = 0.1, 0.2, 0.2, 1.0, 0.0, -2.0
    s.gv[0, 6:] = 9.0
    goal_contacts = np.zeros((2, 16))
    goal_contacts[0, [1, 2, 3, 4]] = 1.0
    goal = GraspGoal(np.zeros((2, 21, 3)), np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 45)), goal_contacts,
                     np.zeros((2, 3)))
    r = Relations(np.zeros((2, 21, 3)), np.zeros((2, 48)))
    r.joint_position_error_H[0, TIPS[0]] = (0.1, 0.0, 0.2)
    r.joint_position_error_H[0, 0] = (0.0, 0.3, 0.0)
    r.pose_error[0, [0, 20]] = 3.0, 4.0
    return s, goal, r


def term(name: str, config: RewardConfig | None = None) -> Array:
    s, goal, r = tiny()
    return TERMS[name](s, goal, r, parameters(config))


def parameters(config: RewardConfig | None = None) -> Parameters:
    config = config or RewardConfig()
    return Parameters(config, keypoint_weights(config, LAYOUT))


def test_key_point_weights_have_mean_one() -> None:
    w = keypoint_weights(RewardConfig(), LAYOUT)
    assert w.mean() == pytest.approx(1.0)
    assert w[list(TIPS)] == pytest.approx(TIP_WEIGHT)
    assert np.delete(w, TIPS) == pytest.approx(JOINT_WEIGHT)
    assert keypoint_weights(RewardConfig(tip_weight=1.0), LAYOUT).tolist() == [1.0] * 21


def test_position_term_with_the_weight_squared_as_the_authors_code_has_it() -> None:
    assert term("position") == pytest.approx([-(TIP_WEIGHT**2 * 0.05 + JOINT_WEIGHT**2 * 0.09), 0.0])


def test_position_term_as_the_paper_writes_it() -> None:
    plain = RewardConfig(squared_weights=False)
    assert term("position", plain) == pytest.approx([-(TIP_WEIGHT * 0.05 + JOINT_WEIGHT * 0.09), 0.0])


def test_terms_by_hand() -> None:
    assert term("pose") == pytest.approx([-5.0, 0.0])
    assert term("contact") == pytest.approx([2 / 4, 0.0])
    assert term("impulse") == pytest.approx([0.05, 0.0])
    assert term("object_velocity") == pytest.approx([9.0, 0.0])
    assert term("object_angular_velocity") == pytest.approx([25.0, 0.0])
    assert term("wrist_linear_velocity") == pytest.approx([0.09, 0.0])
    assert term("wrist_angular_velocity") == pytest.approx([5.0, 0.0])


def test_position_and_pose_have_a_floor() -> None:
    s, goal, r = tiny()
    r.joint_position_error_H[0] = 10.0
    r.pose_error[0] = 10.0
    for name in ("position", "pose"):
        assert TERMS[name](s, goal, r, parameters(RewardConfig())).tolist() == [-10.0, 0.0]
        assert TERMS[name](s, goal, r, parameters(RewardConfig(position_floor=-1.5)))[0] == -1.5


def test_impulse_is_capped_by_the_objects_mass() -> None:
    s, goal, r = tiny()
    s.contact_impulse[0, [1, 3]] = 2.0
    assert TERMS["impulse"](s, goal, r, parameters(RewardConfig()))[0] == pytest.approx(5.0 * 0.4)
    assert TERMS["impulse"](s, goal, r, parameters(RewardConfig(impulse_per_mass=1.0)))[0] == pytest.approx(0.4)


def test_without_goal_contacts_there_is_nothing_to_gain_and_no_nan() -> None:
    s, goal, r = tiny()
    goal.goal_contacts[:] = 0.0
    assert TERMS["contact"](s, goal, r, parameters(RewardConfig())).tolist() == [0.0, 0.0]
    assert TERMS["impulse"](s, goal, r, parameters(RewardConfig())).tolist() == [0.0, 0.0]


def total(config: RewardConfig) -> tuple[Reward, Array, Array]:
    reward = Reward(config, LAYOUT)
    terms, sums = np.zeros((2, len(reward.names)), np.float32), np.zeros(2, np.float32)
    reward(*tiny(), terms, sums)
    return reward, terms, sums


def test_the_reward_is_the_weighted_sum_of_named_terms() -> None:
    reward, terms, sums = total(RewardConfig())
    assert reward.names == ("position", "pose", "contact", "impulse", "object_velocity", "wrist_linear_velocity",
                            "wrist_angular_velocity")
    position = -(TIP_WEIGHT**2 * 0.05 + JOINT_WEIGHT**2 * 0.09)
    expected = [2 * position, -0.5, 0.5, 0.1, -9.0, -0.045, -2.5]
    assert terms[0] == pytest.approx(expected, rel=1e-6)
    assert sums == pytest.approx([sum(expected), 0.0], rel=1e-6)


def test_a_weight_of_zero_leaves_the_term_out_and_another_brings_it_in() -> None:
    reward, terms, _ = total(RewardConfig(pose=0.0, object_angular_velocity=-1.0))
    assert "pose" not in reward.names and "object_angular_velocity" in reward.names
    assert terms[0, reward.names.index("object_angular_velocity")] == -25.0


def test_every_weight_belongs_to_a_term() -> None:
    switches = {"tip_weight", "squared_weights", "position_floor", "impulse_per_mass", "clip"}
    assert set(TERMS) | switches == set(RewardConfig.model_fields)


def test_the_clip_is_off_and_cuts_the_sum_alone() -> None:
    _, terms, sums = total(RewardConfig())
    _, clipped_terms, clipped = total(RewardConfig(clip=-2.0))
    assert sums[0] < -10 and clipped[0] == -2.0 and clipped[1] == 0.0
    assert np.array_equal(terms, clipped_terms)
