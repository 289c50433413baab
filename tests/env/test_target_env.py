"""The tasks with a target: psi and r_m by hand, their invariances, the control of wrist and fingers, and the pools."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.config.experiment import load_config
from dgrasp.config.sections import EnvConfig, MotionConfig, RewardConfig
from dgrasp.control.wrist import move_wrist
from dgrasp.env.features import PSI, FeatureLayer
from dgrasp.env.rewards import Reward
from dgrasp.errors import ConfigError
from dgrasp.motion.targets import training_target
from dgrasp.pool.base import make_env
from dgrasp.pool.process import ProcessPool
from dgrasp.pool.serial import SerialPool
from dgrasp.rl.collect import Actor
from dgrasp.scene.relations import relations
from dgrasp.scene.state import state_views
from dgrasp.types import Array, SceneState
from raisim_like.rotations import rotation_vector
from tests.env.build import goals, hand, label, moved_state, observe, random_state, yaw_and_shift
from tests.scenes import LAYOUT, make_spec

PSI_LAYER = FeatureLayer(EnvConfig(task="motion"), LAYOUT)
SHORT = ["env.grasp_steps=3", "env.episode_steps=7", "physics.substeps=2", "motion.stable_alone=false"]
QUARTER = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()


def frozen(outputs: int = 51, bias: float = 0.0, seed: int = 0) -> Actor:
    """A linear policy of phi with small weights and a bias."""
    weight = np.random.default_rng(seed).normal(size=(outputs, 279)).astype(np.float32) / 100
    return Actor(((weight, np.full(outputs, bias, np.float32)),), np.zeros(outputs, np.float32), 0)


def motion_spec(count: int = 1, grasp: Actor | None = None):
    spec = make_spec(count, ["env.task=motion", *SHORT])
    return type(spec)(spec.labels, spec.hand, spec.objects, spec.config, grasp or frozen())


# psi and r_m ---------------------------------------------------------------------------------------


def by_hand() -> SceneState:
    """H0 a quarter turn about z; the object a quarter turn past its target and (3, 4, 12) m from it."""
    s = state_views(1, LAYOUT)
    s.R_WH0[0] = s.R_WH[0] = QUARTER
    s.joints_W[0, 0] = [0.1, 0.2, 0.3]
    s.gv[0, :6] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    s.object_pos_W[0], s.target_pos_W[0] = [4.0, 5.0, 13.0], [1.0, 1.0, 1.0]
    s.R_WO[0], s.R_WG[0] = QUARTER, np.eye(3)
    s.object_linvel_W[0], s.object_angvel_W[0] = [7.0, 8.0, 9.0], [10.0, 11.0, 12.0]
    return s


def test_psi_by_hand() -> None:
    values = observe(PSI_LAYER, by_hand(), goals(1))[0]
    expected = [0.1, 0.2, 0.3,  0, 0, np.pi / 2,  -2, 1, 3,  -5, 4, 6,
                4, 5, 13,  0, 0, np.pi / 2,  7, 8, 9,  10, 11, 12,  3, 4, 12,  0, 0, np.pi / 2]  # fmt: skip
    assert PSI_LAYER.size == PSI_LAYER.actor_size == 30
    assert values == pytest.approx(expected, abs=1e-12)


def test_the_wrists_angular_velocity_is_what_its_rotation_does() -> None:
    state, h = random_state(8), 1e-6
    later = state.gc + h * state.gv
    R_later, _ = hand().forward(later, state.R_WH0, state.wrist_start_W)
    turned = rotation_vector(np.matmul(R_later, np.swapaxes(state.R_WH, 1, 2))) / h
    part = PSI_LAYER.slices["wrist_angvel_W"]
    assert np.abs(observe(PSI_LAYER, state, goals(8))[:, part] - turned).max() < 1e-4


def test_psi_sees_the_shift_in_positions_alone_and_turns_with_the_scene() -> None:
    state, goal = random_state(8), goals(8)
    before = observe(PSI_LAYER, state, goal)
    shifted = observe(PSI_LAYER, moved_state(state, yaw_and_shift(0.0, 0.7, -2.3)), goal)
    changed = {f.name for f in PSI if np.abs((shifted - before)[:, PSI_LAYER.slices[f.name]]).max() > 1e-9}
    assert changed == {"wrist_position_W", "object_position_W"}
    T = yaw_and_shift(1.1, 0.7, -2.3)
    turned = observe(PSI_LAYER, moved_state(state, T), goal)
    for name in ("wrist_linvel_W", "wrist_angvel_W", "object_linvel_W", "object_angvel_W", "target_offset_W",
                 "target_turn_W"):  # fmt: skip
        part = PSI_LAYER.slices[name]
        assert np.abs(turned[:, part] - before[:, part] @ T[:3, :3].T).max() < 1e-9, name


def test_flat_sees_phi_and_then_psi_and_goals_of_the_label_can_go() -> None:
    flat, phi = FeatureLayer(EnvConfig(task="flat"), LAYOUT), FeatureLayer(EnvConfig(), LAYOUT)
    state, goal = random_state(3), goals(3)
    assert flat.size == 279 + 30
    assert np.array_equal(observe(flat, state, goal)[:, :279], observe(phi, state, goal))
    assert np.array_equal(observe(flat, state, goal)[:, 279:], observe(PSI_LAYER, state, goal))
    assert FeatureLayer(EnvConfig(task="motion", goal_space=False), LAYOUT).size == 30
    # Features that occur in both are included once.
    both = FeatureLayer(EnvConfig(task="flat", features="full_state"), LAYOUT)
    assert both.size == 263 + 30 - len({"wrist_position_W", "wrist_euler_W", "object_position_W", "object_euler_W",
                                        "object_linvel_W", "object_angvel_W"}) * 3  # fmt: skip
    critic = FeatureLayer(EnvConfig(task="motion", critic_features=True), LAYOUT)
    assert (critic.actor_size, critic.size) == (30, 32)


def paid(task: str, state: SceneState, **weights: float) -> tuple[tuple[str, ...], Array]:
    reward, n = Reward(RewardConfig(**weights), LAYOUT, task), len(state.gc)
    terms, total = np.zeros((n, len(reward.names))), np.zeros(n)
    reward(state, goals(n), relations(state, goals(n)), terms, total)
    return reward.names, total


def test_the_reward_of_a_motion_by_hand() -> None:
    names, total = paid("motion", by_hand())
    # 3, 4, 12 are 13 m, and a quarter turn: alpha_x = -2, alpha_q = -0.25.
    assert names == ("target_position", "target_rotation")
    assert total[0] == pytest.approx(-2.0 * 13.0 - 0.25 * np.pi / 2)
    assert paid("motion", by_hand(), target_position=-1.0, target_rotation=0.0)[1][0] == pytest.approx(-13.0)


def test_flat_is_paid_for_both_and_grasping_as_before() -> None:
    state = random_state(4)
    grasp, motion, flat = (paid(task, state) for task in ("grasp", "motion", "flat"))
    assert flat[0] == grasp[0] + motion[0] and not set(grasp[0]) & set(motion[0])
    assert flat[1] == pytest.approx(grasp[1] + motion[1])


def test_the_reward_of_a_motion_does_not_see_where_the_scene_is() -> None:
    state = random_state(8)
    assert paid("motion", moved_state(state, yaw_and_shift(1.1, 0.7, -2.3)))[1] == pytest.approx(
        paid("motion", state)[1]
    )


# The wrist -----------------------------------------------------------------------------------------


def test_the_wrist_moves_along_and_about_the_worlds_axes() -> None:
    state, motion = random_state(6), MotionConfig(sigma_position=0.1, sigma_rotation=0.2)
    actions = np.random.default_rng(1).normal(size=(6, 6))
    target = state.gc.copy()
    move_wrist(target, state, actions, motion, slice(None))
    R_WH, joints = hand().forward(target, state.R_WH0, state.wrist_start_W)
    assert np.abs(joints[:, 0] - state.joints_W[:, 0] - 0.1 * actions[:, :3]).max() < 1e-12
    turn = rotation_vector(np.matmul(R_WH, np.swapaxes(state.R_WH, 1, 2)))
    assert np.abs(turn - 0.2 * actions[:, 3:]).max() < 1e-9
    assert np.array_equal(target[:, 6:], state.gc[:, 6:])


def test_no_action_leaves_the_wrist_and_other_rows_stay() -> None:
    state = random_state(4)
    target = state.gc.copy()
    move_wrist(target, state, np.zeros((4, 6)), MotionConfig(), slice(None))
    assert np.abs(target - state.gc).max() < 1e-12
    move_wrist(target, state, np.ones((4, 6)), MotionConfig(), np.array([2]))
    assert np.flatnonzero(np.abs(target - state.gc).max(axis=1) > 1e-9).tolist() == [2]


# Episodes ------------------------------------------------------------------------------------------


def test_targets_of_training_lie_in_the_authors_box() -> None:
    one, rng = label(), np.random.default_rng(0)
    T = np.array([training_target(one, rng) for _ in range(200)])
    moved = T[:, :3, 3] - one.T_WO[:3, 3]
    assert (np.abs(moved[:, :2]) <= 0.2).all() and (moved[:, 2] >= 0.0).all() and (moved[:, 2] <= 0.3).all()
    assert np.ptp(moved, axis=0) == pytest.approx([0.4, 0.4, 0.3], abs=0.02)
    angles = Rotation.from_matrix(T[:, :3, :3] @ one.T_WO[:3, :3].T).as_euler("XYZ")
    assert 0.45 < np.abs(angles).max() <= 0.5 and (angles.min(axis=0) < -0.4).all()


@pytest.mark.parametrize("task", ["motion", "flat"])
def test_a_target_belongs_to_seed_epoch_and_environment_and_shows_in_psi(task: str) -> None:
    spec = motion_spec(2) if task == "motion" else make_spec(2, ["env.task=flat", *SHORT])
    whole, second = make_env(spec), make_env(spec, slice(1, 2))
    seen = [whole.reset(epoch).copy() for epoch in (4, 5, 4)]
    part = whole.layer.slices["target_offset_W"]
    assert np.array_equal(seen[0], seen[2]) and not np.array_equal(seen[0][:, part], seen[1][:, part])
    assert not np.allclose(whole.s.target_pos_W[0], whole.s.target_pos_W[1])
    assert np.array_equal(second.reset(4)[0], seen[0][1])
    whole.reset(4)
    assert seen[0][:, part] == pytest.approx(whole.s.object_pos_W - whole.s.target_pos_W, abs=1e-6)
    whole.close()
    second.close()


def test_the_frozen_policy_has_the_fingers_and_psi_the_wrist() -> None:
    env = make_env(motion_spec(grasp=frozen(bias=1.0)))
    assert env.action_size == 6 and env.observation_size == 30
    observation = env.reset(0)
    # A training reset makes the grasp; the reward begins after it.
    assert env.clock[0] == 3 and np.isfinite(observation).all()
    before = env.s.gc.copy()
    phi = observe(FeatureLayer(EnvConfig(), LAYOUT), env.s, env.goal).astype(np.float32)
    means = np.zeros((1, 51), np.float32)
    frozen(bias=1.0).means(phi, means)
    action = np.array([[1.0, -2.0, 3.0, 0.0, 0.0, 0.0]])
    out = env.step(action)
    lower, upper = hand().limits.T
    fingers = np.clip(before[:, 6:] + 0.015 * means[:, 6:], lower[6:], upper[6:])
    assert np.abs(env._target[:, 6:] - fingers).max() < 1e-6
    shift_W = env.s.R_WH0[0] @ (env._target[0, :3] - before[0, :3])
    assert shift_W == pytest.approx(0.01 * action[0, :3], abs=1e-9)
    assert env._target[0, 3:6] == pytest.approx(before[0, 3:6], abs=1e-9)
    assert out.reward[0] < 0.0
    env.close()


def test_nothing_is_paid_and_no_action_counts_before_the_motion_of_a_test() -> None:
    still, pushed = make_env(motion_spec()), make_env(motion_spec())
    for env, push in ((still, 0.0), (pushed, 5.0)):
        env.reset(0, "test")
        out = env.step(np.full((1, 6), push))
        assert out.reward[0] == 0.0 and not out.reward_terms.any()
    assert np.array_equal(still.s.gc, pushed.s.gc)
    path = np.tile(np.eye(4), (1, 1, 1, 1))
    path[0, 0, :3, 3] = [0.5, 0.2, 1.0]
    pushed.begin_motion(path)
    # The policy sees the target before its first action.
    part = pushed.layer.slices["target_offset_W"]
    assert pushed.o.observation[0, part] == pytest.approx(pushed.s.object_pos_W[0] - path[0, 0, :3, 3], abs=1e-6)
    assert pushed.step(np.full((1, 6), 5.0)).reward[0] < 0.0
    still.step(np.zeros((1, 6)))
    assert not np.allclose(still.s.gc[:, :3], pushed.s.gc[:, :3])
    still.close()
    pushed.close()


def test_flat_has_wrist_and_fingers_from_the_first_step() -> None:
    env = make_env(make_spec(1, ["env.task=flat", "env.wrist=residual", *SHORT]))
    env.reset(0)
    before, actions = env.s.gc.copy(), np.zeros((1, 51), np.float32)
    actions[0, 0], actions[0, 20] = 2.0, 1.0
    out = env.step(actions)
    shift_W = env.s.R_WH0[0] @ (env._target[0, :3] - before[0, :3])
    assert shift_W == pytest.approx([0.02, 0.0, 0.0], abs=1e-9)
    lower, upper = hand().limits[20]
    assert env._target[0, 20] == pytest.approx(np.clip(before[0, 20] + 0.015, lower, upper))
    assert set(env.reward_terms) > {"contact", "target_position"} and np.isfinite(out.reward).all()
    env.close()


@pytest.mark.parametrize("task", ["motion", "flat"])
def test_collecting_is_the_same_to_the_bit_however_the_labels_are_divided(task: str) -> None:
    spec = motion_spec(3) if task == "motion" else make_spec(3, ["env.task=flat", *SHORT])
    steps = spec.config.learned_steps(1)
    assert steps == (4 if task == "motion" else 7)
    serial, pool = SerialPool(spec), ProcessPool(spec, 2)
    weight = np.random.default_rng(2).normal(size=(serial.action_size, serial.observation_size)) / 50
    actor = Actor(((weight.astype(np.float32), np.zeros(serial.action_size, np.float32)),),
                  np.full(serial.action_size, 0.5, np.float32), 3)  # fmt: skip
    try:
        assert (pool.action_size, pool.observation_size, pool.reward_terms) == (
            serial.action_size, serial.observation_size, serial.reward_terms)  # fmt: skip
        reference = serial.collect(actor, 2, steps, lambda n: None)
        divided = pool.collect(actor, 2, steps, lambda n: None)
        for name, array in vars(reference).items():
            assert array.tobytes() == getattr(divided, name).tobytes(), name
        assert reference.truncated[-1].all() and reference.truncated.sum() == 3
        # The observations of a test at the beginning of a motion are the same too.
        shown = []
        path = np.tile(np.eye(4), (3, 1, 1, 1))
        for one in (serial, pool):
            observation = one.reset(0, "test")
            one.begin_motion(path)
            shown.append(observation.copy())
        assert np.array_equal(*shown)
    finally:
        serial.close()
        pool.close()


def test_a_task_with_a_target_keeps_its_table() -> None:
    with pytest.raises(ConfigError, match="the table stays in task flat"):
        load_config(None, ["env.task=flat", "env.hold.first_step=45"])


def test_no_element_of_psi_is_constant() -> None:
    values = observe(PSI_LAYER, random_state(64), goals(64))
    assert (np.ptp(values, axis=0) > 0).all()
