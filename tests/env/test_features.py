"""The feature layer: its layout, its frames, and its invariances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dgrasp.config.sections import EnvConfig
from dgrasp.env.features import FEATURE_LAYERS, PHI, FeatureLayer, features_page
from dgrasp.env.goal import make_goal
from dgrasp.scene.relations import goal_wrist_position_W, relations
from dgrasp.types import Array
from raisim_like.rotations import euler_from_matrix, matrix_from_euler, matrix_from_rotation_vector, transform
from tests.env.build import (
    copy_state,
    goals,
    moved_label,
    moved_state,
    observe,
    random_labels,
    random_rotations,
    random_state,
    state_at,
    yaw_and_shift,
)
from tests.scenes import LAYOUT

PUBLISHED = {
    "joint_positions": (0, 51),
    "wrist_linvel": (51, 54),
    "wrist_angvel": (54, 57),
    "finger_velocities": (57, 102),
    "joint_position_error_H": (102, 165),
    "pose_error": (165, 213),
    "wrist_from_object_H": (213, 216),
    "object_linvel_H": (216, 219),
    "object_angvel_H": (219, 222),
    "goal_contacts": (222, 238),
    "contact_impulse": (238, 254),
    "achieved_contacts": (254, 270),
    "object_displacement_H": (270, 273),
    "table_height_H": (273, 276),
    "object_euler_H": (276, 279),
}
GOAL_BLOCKS = {"joint_position_error_H", "pose_error", "goal_contacts", "achieved_contacts"}


def test_phi_has_the_order_of_the_published_policies() -> None:
    layer = FeatureLayer(EnvConfig(), LAYOUT)
    assert {name: (part.start, part.stop) for name, part in layer.slices.items()} == PUBLISHED
    assert list(layer.slices) == list(PUBLISHED)
    assert layer.size == sum(feature.size_for(LAYOUT) for feature in PHI) == 279


@pytest.mark.parametrize("name", FEATURE_LAYERS)
def test_blocks_follow_each_other_and_fill_the_observation(name: str) -> None:
    layer = FeatureLayer(EnvConfig(features=name), LAYOUT)
    state, goal = random_state(3), goals(3)
    end = 0
    for feature in layer.features:
        assert layer.slices[feature.name].start == end
        assert np.shape(feature.value(state, goal, relations(state, goal))) == (3, feature.size_for(LAYOUT))
        assert feature.frame and feature.unit
        end = layer.slices[feature.name].stop
    assert layer.size == end and len(layer.slices) == len(layer.features)


def test_phi_does_not_see_where_on_the_table_the_scene_is() -> None:
    state, labels, layer = random_state(8), random_labels(8), FeatureLayer(EnvConfig(), LAYOUT)
    T = yaw_and_shift(1.1, 0.7, -2.3)
    before = observe(layer, state, make_goal(labels))
    after = observe(layer, moved_state(state, T), make_goal([moved_label(one, T) for one in labels]))
    assert np.abs(after - before).max() < 1e-9


def test_without_the_layer_the_policy_sees_the_place() -> None:
    state, labels, layer = random_state(8), random_labels(8), FeatureLayer(EnvConfig(features="full_state"), LAYOUT)
    T = yaw_and_shift(1.1, 0.7, -2.3)
    difference = observe(layer, moved_state(state, T), make_goal(labels)) - observe(layer, state, make_goal(labels))
    changed = {f.name for f in layer.features if np.abs(difference[:, layer.slices[f.name]]).max() > 1e-9}
    assert changed == {f.name for f in layer.features if f.frame == "W"}


def test_goal_errors_do_not_see_any_rigid_motion() -> None:
    state, goal = random_state(8), goals(8)
    T = transform(random_rotations(1, np.random.default_rng(3))[0], np.array([1.0, 2.0, -0.5]))
    before, after = relations(state, goal), relations(moved_state(state, T), goal)
    assert np.abs(after.joint_position_error_H - before.joint_position_error_H).max() < 1e-12
    assert np.abs(after.pose_error - before.pose_error).max() < 1e-12


@pytest.mark.parametrize("name", FEATURE_LAYERS)
def test_no_element_is_constant(name: str) -> None:
    layer = FeatureLayer(EnvConfig(features=name), LAYOUT)
    observation = observe(layer, random_state(64), goals(64))
    constant = [f.name for f in layer.features if (np.ptp(observation[:, layer.slices[f.name]], axis=0) == 0).any()]
    assert constant == []


@pytest.mark.parametrize("name", FEATURE_LAYERS)
def test_without_goal_space_exactly_the_goal_blocks_are_missing(name: str) -> None:
    full = FeatureLayer(EnvConfig(features=name), LAYOUT)
    bare = FeatureLayer(EnvConfig(features=name, goal_space=False), LAYOUT)
    dropped = set(full.slices) - set(bare.slices)
    if name == "phi":
        assert dropped == GOAL_BLOCKS
        assert bare.size == 279 - 63 - 48 - 16 - 16
    assert dropped == {f.name for f in full.features if f.is_goal} and dropped
    state, goal, other = random_state(4), goals(4), goals(4, seed=9)
    first, second = observe(full, state, goal), observe(bare, state, goal)
    for kept in bare.slices:
        assert np.array_equal(first[:, full.slices[kept]], second[:, bare.slices[kept]])
    # No other feature depends on the goal.
    assert np.array_equal(second, observe(bare, state, other))


def test_nothing_is_left_to_do_at_the_goal() -> None:
    labels = random_labels(5)
    r = relations(state_at(labels), make_goal(labels))
    assert np.abs(r.joint_position_error_H).max() < 1e-12
    assert np.abs(r.pose_error).max() < 1e-12


def one_of_each(layer: FeatureLayer, R_WH: Array) -> dict[str, Array]:
    """Blocks of a state with round numbers and the wrist turned by R_WH; object and H0 along the world's axes."""
    labels = random_labels(1)
    state = state_at(labels)
    state.R_WH[:] = R_WH
    state.R_WO[:] = np.eye(3)
    state.joints_W[:] = 0.0
    state.joints_W[0, 0] = (1.0, 2.0, 0.8)
    state.object_pos_W[0] = (0.7, 2.1, 0.55)
    state.object_start_W[0] = (0.7, 2.0, 0.5)
    state.object_linvel_W[0], state.object_angvel_W[0] = (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)
    state.gv[0] = np.arange(51)
    state.contacts[0, [0, 4, 9]] = 1.0
    state.contact_impulse[0, [0, 4, 9]] = 0.1, 0.2, 0.3
    goal = make_goal(labels)
    goal.goal_contacts[:] = 0.0
    goal.goal_contacts[0, [4, 5]] = 1.0
    observation = observe(layer, state, goal)[0]
    return {name: observation[part] for name, part in layer.slices.items()}


def test_blocks_by_hand_with_the_wrist_along_the_axes() -> None:
    b = one_of_each(FeatureLayer(EnvConfig(), LAYOUT), np.eye(3))
    assert b["wrist_linvel"].tolist() == [0, 1, 2] and b["wrist_angvel"].tolist() == [3, 4, 5]
    assert b["finger_velocities"].tolist() == list(range(6, 51))
    assert np.allclose(b["wrist_from_object_H"], [0.3, -0.1, 0.25], atol=1e-15)
    assert b["object_linvel_H"].tolist() == [1, 2, 3] and b["object_angvel_H"].tolist() == [4, 5, 6]
    assert np.flatnonzero(b["goal_contacts"]).tolist() == [4, 5]
    assert np.flatnonzero(b["achieved_contacts"]).tolist() == [4]
    assert b["contact_impulse"][[0, 4, 9]].tolist() == [0.1, 0.2, 0.3]
    # From the object's position to its start; the wrist's height above a table top at 0.5 m.
    assert np.allclose(b["object_displacement_H"], [0, -0.1, -0.05], atol=1e-15)
    assert np.allclose(b["table_height_H"], [0, 0, 0.3], atol=1e-15)
    assert b["object_euler_H"].tolist() == [0, 0, 0]


def test_blocks_by_hand_with_the_wrist_turned_about_x() -> None:
    """A quarter turn about x: the world's up direction is the wrist's y axis."""
    b = one_of_each(FeatureLayer(EnvConfig(), LAYOUT), np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))
    assert np.allclose(b["table_height_H"], [0, 0.3, 0], atol=1e-15)
    assert np.allclose(b["wrist_from_object_H"], [0.3, 0.25, 0.1], atol=1e-15)
    assert np.allclose(b["object_linvel_H"], [1, 3, -2], atol=1e-15)
    assert np.allclose(b["object_angvel_H"], [4, 6, -5], atol=1e-15)
    assert np.allclose(b["object_displacement_H"], [0, -0.05, 0.1], atol=1e-15)
    assert np.allclose(b["object_euler_H"], [-np.pi / 2, 0, 0], atol=1e-15)


def test_errors_are_goal_minus_now_in_the_wrist_frame() -> None:
    labels = random_labels(1)
    state, goal = state_at(labels), make_goal(labels)
    state.joints_W[0, 7] += state.R_WH[0] @ [0.01, 0.02, 0.03]
    state.gc[0, 6 + 11] += 0.2
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    r = relations(state, goal)
    assert np.allclose(r.joint_position_error_H[0, 7], [-0.01, -0.02, -0.03], atol=1e-12)
    assert np.abs(np.delete(r.joint_position_error_H[0], 7, axis=0)).max() < 1e-12
    assert np.allclose(r.pose_error[0, 3 + 11], -0.2, atol=1e-12)
    state.R_WH[:] = state.R_WO @ goal.R_OH @ turn
    assert np.allclose(
        relations(state, goal).pose_error[0, :3],
        (goal.wrist_euler_O - euler_from_matrix(goal.R_OH @ turn))[0], atol=1e-12,
    )


def test_the_goal_wrist_goes_with_the_object() -> None:
    labels = random_labels(4)
    state, goal = state_at(labels), make_goal(labels)
    assert np.abs(goal_wrist_position_W(state, goal) - [one.T_WH[:3, 3] for one in labels]).max() < 1e-12
    T = transform(random_rotations(1, np.random.default_rng(5))[0], np.array([0.1, -0.3, 0.2]))
    moved = goal_wrist_position_W(moved_state(state, T), goal)
    assert np.abs(moved - [(T @ one.T_WH)[:3, 3] for one in labels]).max() < 1e-12


def test_observing_changes_nothing_and_keeps_nothing() -> None:
    state, goal, layer = random_state(3), goals(3), FeatureLayer(EnvConfig(), LAYOUT)
    before = copy_state(state)
    out = np.zeros((3, 279), np.float32)
    layer(state, goal, relations(state, goal), out)
    kept = out.copy()
    state.gc[:] = 7.0
    assert np.array_equal(out, kept)
    assert np.array_equal(state.R_WO, before.R_WO) and np.array_equal(state.contact_impulse, before.contact_impulse)


def test_the_page_in_docs_is_the_specification() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "features.md"
    assert page.read_text(encoding="utf-8") == features_page()


def test_scaled_features_are_the_plain_ones_times_their_scale_and_clamped() -> None:
    state, goal = random_state(4), goals(4)
    plain, scaled = FeatureLayer(EnvConfig(), LAYOUT), FeatureLayer(EnvConfig(scaled_features=True), LAYOUT)
    a, b = np.zeros((4, plain.size), np.float32), np.zeros((4, plain.size), np.float32)
    plain(state, goal, relations(state, goal), a)
    scaled(state, goal, relations(state, goal), b)
    for name, scale in (("joint_position_error_H", 10.0), ("finger_velocities", 0.2), ("goal_contacts", 1.0)):
        part = plain.slices[name]
        assert b[:, part] == pytest.approx(np.clip(scale * a[:, part], -5.0, 5.0), abs=1e-5)
    assert b[:, :3] == pytest.approx(np.clip(5.0 * a[:, :3], -5.0, 5.0), abs=1e-5)
    assert b[:, 3:51] == pytest.approx(np.clip(a[:, 3:51], -5.0, 5.0), abs=1e-5)
    assert np.abs(b).max() <= 5.0


def test_the_critic_s_features_come_last_and_are_not_the_actor_s() -> None:
    state, goal = random_state(2), goals(2)
    state.table_gone[:], state.episode_time[:] = [0.0, 1.0], [0.25, 0.75]
    layer = FeatureLayer(EnvConfig(critic_features=True), LAYOUT)
    assert (layer.actor_size, layer.size) == (279, 281)
    out = np.zeros((2, layer.size), np.float32)
    layer(state, goal, relations(state, goal), out)
    assert out[:, 279:].tolist() == [[0.0, 0.25], [1.0, 0.75]]


def test_the_wrists_error_as_a_rotation_vector_does_not_jump() -> None:
    """One degree to either side of half a turn about x is two degrees apart, whatever the Euler angles say."""
    labels = random_labels(1)
    goal, state = make_goal(labels), state_at(labels)
    degree = np.radians(1.0)
    for name, value in (("R_OH", np.pi - degree), ("R_WH", np.pi + degree)):
        target = goal if name == "R_OH" else state
        getattr(target, name)[0] = matrix_from_euler(np.array([value, 0.0, 0.0]))
    state.R_WO[0] = np.eye(3)
    goal.wrist_euler_O[0] = euler_from_matrix(goal.R_OH[0])
    assert np.abs(relations(state, goal).pose_error[0, :3]).max() > 6.0
    error = relations(state, goal, "rotation_vector").pose_error[0, :3]
    assert error == pytest.approx([-2.0 * degree, 0.0, 0.0], abs=1e-9)


def test_the_rotation_vector_leads_to_the_goal_and_does_not_depend_on_the_scenes_place() -> None:
    labels, state = random_labels(6), random_state(6)
    goal = make_goal(labels)
    error = relations(state, goal, "rotation_vector").pose_error
    R_OH = np.matmul(np.swapaxes(state.R_WO, 1, 2), state.R_WH)
    assert matrix_from_rotation_vector(error[:, :3]) @ R_OH == pytest.approx(goal.R_OH, abs=1e-9)
    moved = relations(moved_state(state, yaw_and_shift(1.1, 0.7, -2.3)), goal, "rotation_vector").pose_error
    assert moved == pytest.approx(error, abs=1e-9)
    assert np.array_equal(error[:, 3:], relations(state, goal).pose_error[:, 3:])
    # What policies were trained with before there was a choice.
    assert EnvConfig().wrist_error == "euler"
