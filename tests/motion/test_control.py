"""The wrist controller of motion synthesis, on states made by hand and in a world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.config.sections import ActionConfig, MotionConfig
from dgrasp.control.controllers import HOLD_KP_POSITION
from dgrasp.control.motion import MotionSynthesis, nearest_euler, wrist_target
from dgrasp.scene.scene import OBJECT
from dgrasp.types import Array, SceneState
from raisim_like.rotations import (
    euler_from_matrix,
    matrix_from_euler,
    matrix_from_rotation_vector,
    rotation_vector,
    transform,
)
from tests.env.build import hand, make_env, moved_state, random_rotations, random_state
from tests.scenes import LAYOUT

ACTION = ActionConfig()
N = 6


def wrist_pose(state: SceneState, coordinates: Array) -> Array:
    """(N, 4, 4) the wrist in the world at coordinates (N, 6)."""
    gc = state.gc.copy()
    gc[:, :6] = coordinates
    R, joints = hand().forward(gc, state.R_WH0, state.wrist_start_W)
    return transform(R, joints[:, 0])


def poses(state: SceneState) -> tuple[Array, Array, Array]:
    """T_WH, T_WO, T_WG."""
    return (transform(state.R_WH, state.joints_W[:, 0]), transform(state.R_WO, state.object_pos_W),
            transform(state.R_WG, state.target_pos_W))


def test_rotation_vectors_there_and_back() -> None:
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(50, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    vectors = axes * np.concatenate([[0.0, 1e-14, 1e-9, 1e-4, np.pi - 1e-9], rng.uniform(0, np.pi, 45)])[:, None]
    R = matrix_from_rotation_vector(vectors)
    assert np.abs(R - Rotation.from_rotvec(vectors).as_matrix()).max() < 1e-14
    assert np.abs(rotation_vector(R) - vectors).max() < 1e-7
    # A quarter turn about z takes x to y.
    assert np.allclose(matrix_from_rotation_vector(np.array([0.0, 0.0, np.pi / 2])) @ [1, 0, 0], [0, 1, 0])


def test_a_whole_step_puts_the_object_at_its_target() -> None:
    state = random_state(N)
    T_WH, T_WO, T_WG = poses(state)
    there = wrist_pose(state, wrist_target(state, np.ones(N), np.ones(N)))
    # The object is fixed in the hand: T_WO' = T_WH' T_HO.
    assert np.abs(there @ np.linalg.inv(T_WH) @ T_WO - T_WG).max() < 1e-12


def test_a_part_of_a_step_goes_straight_and_turns_about_the_objects_origin() -> None:
    state = random_state(N)
    T_WH, T_WO, T_WG = poses(state)
    moved = wrist_pose(state, wrist_target(state, np.full(N, 0.25), np.full(N, 0.5))) @ np.linalg.inv(T_WH) @ T_WO
    assert np.abs(moved[:, :3, 3] - (0.75 * T_WO[:, :3, 3] + 0.25 * T_WG[:, :3, 3])).max() < 1e-12
    halfway = np.linalg.norm(rotation_vector(T_WG[:, :3, :3] @ moved[:, :3, :3].swapaxes(1, 2)), axis=1)
    whole = np.linalg.norm(rotation_vector(T_WG[:, :3, :3] @ T_WO[:, :3, :3].swapaxes(1, 2)), axis=1)
    assert halfway == pytest.approx(0.5 * whole, abs=1e-9)


def test_at_the_target_the_wrist_stays() -> None:
    state = random_state(N)
    state.R_WG[:], state.target_pos_W[:] = state.R_WO, state.object_pos_W
    assert np.abs(wrist_target(state, np.ones(N), np.ones(N)) - state.gc[:, :6]).max() < 1e-9


def test_a_moved_scene_gives_the_same_coordinates() -> None:
    state = random_state(N)
    T = transform(random_rotations(1, np.random.default_rng(3))[0], np.array([0.4, -0.2, 0.1]))
    beta = np.full(N, 0.3)
    assert np.abs(wrist_target(moved_state(state, T), beta, beta) - wrist_target(state, beta, beta)).max() < 1e-9


def test_the_gain_grows_in_equal_steps() -> None:
    state = random_state(2)
    state.R_WG[:] = state.R_WO
    control = MotionSynthesis(ACTION, MotionConfig(beta_position=0.8, ramp_position=4), LAYOUT)
    whole = wrist_target(state, np.ones(2), np.zeros(2))[:, :3] - state.gc[:, :3]
    out, shares = np.empty((2, 51)), []
    for _ in range(7):
        control.bias(state, None, out)
        shares.append(((out[:, :3] - state.gc[:, :3]) / whole).mean(axis=1))
    for one in np.array(shares).T:
        assert one == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 0.8, 0.8])


def test_the_policy_keeps_the_fingers_or_they_are_held() -> None:
    state, out = random_state(2), np.empty((2, 51))
    free = MotionSynthesis(ACTION, MotionConfig(), LAYOUT)
    assert (free.sigma[:6] == 0.0).all() and (free.sigma[6:] == ACTION.sigma_fingers).all()
    assert free.kp_position == HOLD_KP_POSITION == 500.0
    free.bias(state, None, out)
    assert np.array_equal(out[:, 6:], state.gc[:, 6:])
    held = np.arange(90.0).reshape(2, 45)
    static = MotionSynthesis(ACTION, MotionConfig(), LAYOUT, held)
    static.bias(state, None, out)
    assert np.array_equal(out[:, 6:], held) and (static.sigma == 0.0).all()


def test_the_nearest_angles_are_the_rotation_and_near() -> None:
    rng = np.random.default_rng(1)
    near = rng.uniform(-6.0, 6.0, (300, 3))
    # A rotation a little off what these angles are.
    R = matrix_from_euler(near) @ random_rotations(300, rng, 0.02)
    angles = nearest_euler(R, near)
    assert np.abs(matrix_from_euler(angles) - R).max() < 1e-12
    steep = np.abs(np.cos(near[:, 1])) < 0.1
    assert np.abs(angles - near)[~steep].max() < 0.3
    # No other angles of this rotation are nearer.
    principal = euler_from_matrix(R)
    assert (np.linalg.norm(angles - near, axis=1) <= np.linalg.norm(principal - near, axis=1) + 1e-12).all()


def test_angles_follow_a_turn_past_pi_and_past_the_gimbal_lock() -> None:
    for axis in range(3):
        q = np.zeros((1, 3))
        for turned in np.arange(0.0, 4.0, 0.05):
            vector = np.zeros((1, 3))
            vector[0, axis] = turned
            q = nearest_euler(matrix_from_rotation_vector(vector), q)
        assert q[0, axis] == pytest.approx(3.95) and np.abs(np.delete(q[0], axis)).max() < 1e-6


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_at_the_gimbal_lock_two_angles_share_the_turn(side: float) -> None:
    near = np.array([[0.3, side * np.pi / 2, 0.1]])
    R = matrix_from_euler(near + np.array([[0.2, 0.0, 0.0]]))
    angles = nearest_euler(R, near)
    assert np.abs(matrix_from_euler(angles) - R).max() < 1e-9
    # 0.2 rad are to go, of a + c or of a - c: half each is nearest.
    assert angles[0] == pytest.approx([0.4, side * np.pi / 2, 0.1 + side * 0.1], abs=1e-9)


def test_in_a_world_the_wrist_brings_what_it_holds_to_the_target() -> None:
    env = make_env(1, overrides=["physics.preset=fast", "motion.ramp_position=60", "motion.ramp_rotation=60"])
    try:
        env.reset(mode="test")
        batch, action = env.worlds.batch, np.zeros((1, 51), np.float32)
        start = env.s.gc[0, :6].copy()
        T_HO = transform(np.eye(3), np.array([0.1, 0.0, 0.0]))
        advance, object_state = batch.advance, batch.state.bodies[0, OBJECT]

        def glued(rows: Sequence[int], targets: Array, substeps: int) -> None:
            """The object sits in the hand, whatever the simulated one does."""
            advance(rows, targets, substeps)
            R, joints = hand().forward(env.s.gc, env.s.R_WH0, env.s.wrist_start_W)
            T = transform(R, joints[:, 0])[0] @ T_HO
            object_state[:3], object_state[3:7] = T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat()[[3, 0, 1, 2]]

        batch.advance = glued  # type: ignore[method-assign]
        env.step(action)
        T_WO = transform(env.s.R_WO, env.s.object_pos_W)
        T_WG = T_WO.copy()
        T_WG[:, :3, 3] += [0.1, -0.05, 0.2]
        T_WG[:, :3, :3] = Rotation.from_rotvec([0.3, -0.4, 0.2]).as_matrix() @ T_WO[:, :3, :3]
        env.begin_motion(T_WG[:, None], "pose")
        assert np.allclose(env.s.target_pos_W, T_WG[:, :3, 3])
        for _ in range(150):
            env.step(action)
        # What is left is the hand's weight over kp, and the object's that is not there: millimetres.
        assert np.linalg.norm(env.s.object_pos_W - T_WG[:, :3, 3]) < 0.02
        assert np.linalg.norm(rotation_vector(env.s.R_WG @ env.s.R_WO.swapaxes(1, 2))) < 0.1
        assert np.abs(env.s.gc[0, :6] - start).max() > 0.1
    finally:
        env.close()


def test_targets_follow_the_path_and_the_last_one_stays() -> None:
    env = make_env(2, overrides=["physics.substeps=1"])
    try:
        env.reset(mode="test")
        assert np.array_equal(env.s.target_pos_W, env.s.object_start_W)
        path = np.tile(np.eye(4), (2, 3, 1, 1))
        path[:, :, 0, 3] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
        env.begin_motion(path)
        seen = []
        for _ in range(4):
            env.step(np.zeros((2, 51), np.float32))
            seen.append(env.s.target_pos_W[:, 0].tolist())
        assert seen == [[1.0, 4.0], [2.0, 5.0], [3.0, 6.0], [3.0, 6.0]]
        env.reset(mode="test")
        assert np.array_equal(env.s.target_pos_W, env.s.object_start_W)
        env.step(np.zeros((2, 51), np.float32))
        assert np.array_equal(env.s.target_pos_W, env.s.object_start_W)
    finally:
        env.close()


def test_fingers_are_held_at_their_targets_or_where_they_are() -> None:
    env = make_env(1, overrides=["physics.substeps=2"])
    try:
        env.reset(mode="test")
        path = np.tile(np.eye(4), (1, 1, 1, 1))
        action = np.full((1, 51), 2.0, np.float32)
        for fingers in ("target", "pose"):
            env.reset(mode="test")
            env.step(action)
            last, where = env._target[0, 6:].copy(), env.s.gc[0, 6:].copy()
            env.begin_motion(path, fingers)  # type: ignore[arg-type]
            env.step(action)
            limits = env.hand.limits[6:].T
            expected = last if fingers == "target" else np.clip(where, *limits)
            assert np.allclose(env._target[0, 6:], expected, atol=1e-12)
            assert fingers == "target" or not np.allclose(last, where)
        # In the label's pose there is no step before it: the fingers hold the label.
        env.reset(mode="label")
        env.begin_motion(path, "target")
        env.step(action)
        label = np.clip(env.labels[0].hand_pose, *limits)
        assert np.allclose(env._target[0, 6:], label)
    finally:
        env.close()
