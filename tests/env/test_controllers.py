"""The bias to which the residual action is added, in each phase."""

from __future__ import annotations

import numpy as np

from dgrasp.config.sections import ActionConfig
from dgrasp.control.controllers import (
    GRASP_CONTROLLERS,
    HOLD_KP_POSITION,
    Controller,
    LabelPose,
    Residual,
    WristGuidance,
    WristHold,
)
from dgrasp.env.goal import make_goal
from dgrasp.types import Array, SceneState
from raisim_like.rotations import transform
from tests.env.build import goals, hand, moved_state, random_labels, random_rotations, random_state, state_at
from tests.scenes import LAYOUT

ACTION = ActionConfig()


def bias(controller: Controller, state: SceneState, goal: object = None) -> Array:
    out = np.full((len(state.gc), 51), np.nan)
    controller.bias(state, goals(len(state.gc)) if goal is None else goal, out)  # type: ignore[arg-type]
    return out


def test_guidance_leads_the_wrist_to_the_labels_wrist_wherever_the_object_is() -> None:
    labels = random_labels(5)
    goal = make_goal(labels)
    T = transform(random_rotations(1, np.random.default_rng(4))[0], np.array([0.2, -0.1, 0.05]))
    state = random_state(5)
    for name in ("R_WO", "object_pos_W"):
        getattr(state, name)[:] = getattr(moved_state(state_at(labels), T), name)
    target = bias(WristGuidance(ACTION, LAYOUT), state, goal)
    # With these coordinates the hand has the label's wrist pose, moved along with the object.
    _, joints = hand().forward(target, state.R_WH0, state.wrist_start_W)
    assert np.abs(joints[:, 0] - [(T @ one.T_WH)[:3, 3] for one in labels]).max() < 1e-12
    assert np.array_equal(target[:, 3:], state.gc[:, 3:])


def test_guidance_at_the_goal_stays() -> None:
    labels = random_labels(3)
    state = state_at(labels)
    assert np.abs(bias(WristGuidance(ACTION, LAYOUT), state, make_goal(labels)) - state.gc).max() < 1e-12


def test_without_guidance_everything_is_biased_to_where_it_is() -> None:
    state = random_state(4)
    assert np.array_equal(bias(Residual(ACTION, LAYOUT), state), state.gc)


def test_hold_keeps_the_wrist_where_it_was_and_leaves_the_fingers_free() -> None:
    state = random_state(4)
    then = state.gc.copy()
    controller = WristHold(ACTION, LAYOUT, state)
    state.gc += 0.3
    target = bias(controller, state)
    assert np.array_equal(target[:, :6], then[:, :6])
    assert np.array_equal(target[:, 6:], state.gc[:, 6:])


def test_the_label_pose_is_the_initial_wrist_and_the_labels_fingers() -> None:
    state, goal = random_state(4), goals(4)
    target = bias(LabelPose(ACTION, LAYOUT), state, goal)
    assert np.array_equal(target, np.hstack([np.zeros((4, 6)), goal.hand_pose]))


def test_the_scale_of_the_action() -> None:
    state = random_state(1)
    rest = [0.01] * 3 + [0.015] * 45
    assert WristGuidance(ACTION, LAYOUT).sigma.tolist() == [0.001] * 3 + rest
    assert Residual(ACTION, LAYOUT).sigma.tolist() == [0.01] * 3 + rest
    assert WristHold(ACTION, LAYOUT, state).sigma.tolist() == [0.0] * 6 + [0.015] * 45
    assert LabelPose(ACTION, LAYOUT).sigma.tolist() == [0.0] * 51
    own = ActionConfig(sigma_wrist_position=0.002, sigma_wrist_rotation=0.03, sigma_fingers=0.04)
    assert WristGuidance(own, LAYOUT).sigma.tolist() == [0.002] * 3 + [0.03] * 3 + [0.04] * 45


def test_the_wrist_is_stiff_where_it_holds_the_object() -> None:
    state = random_state(1)
    soft = [WristGuidance(ACTION, LAYOUT), Residual(ACTION, LAYOUT)]
    firm = [WristHold(ACTION, LAYOUT, state), LabelPose(ACTION, LAYOUT)]
    assert [c.kp_position for c in soft] == [50.0] * 2
    assert [c.kp_position for c in firm] == [HOLD_KP_POSITION] * 2 == [500.0] * 2
    by_name = {"guidance": WristGuidance, "residual": Residual}
    assert by_name == GRASP_CONTROLLERS
