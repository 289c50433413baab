"""The Gymnasium interface passes Gymnasium's own checker and declares its autoreset correctly."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import dgrasp
from dgrasp.config.experiment import load_config
from dgrasp.errors import ConfigError, DataError
from dgrasp.gym import ACTION_SCALE, GraspGymEnv, GraspVectorEnv

STEPS = 32
FREE = ["data=free", "labels.objects=[004_sugar_box]", f"env.episode_steps={STEPS}", "env.grasp_steps=20"]


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make("dgrasp/Grasp-v0", overrides=FREE, render_mode="rgb_array")
    yield made
    made.close()


def test_gymnasiums_checker_is_satisfied(env):
    check_env(env.unwrapped)


def test_spaces_are_bounded_and_rendering_gives_a_picture(env):
    assert np.isfinite(env.observation_space.low).all() and np.isfinite(env.action_space.high).all()
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (240, 320, 3) and picture.dtype == np.uint8 and picture.std() > 10


def test_the_seed_fixes_the_start(env):
    first, again, other = (env.reset(seed=s)[0] for s in (5, 5, 6))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_an_episode_ends_by_truncation_and_names_its_reward_terms(env):
    env.reset(seed=1)
    for t in range(STEPS):
        _, reward, terminated, truncated, info = env.step(np.zeros(51, np.float32))
        assert not terminated and truncated == (t == STEPS - 1)
        assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=1e-5)
        assert info["inertia"] == "true"


def test_vector_env_restarts_in_the_same_step():
    venv = gymnasium.make_vec("dgrasp/Grasp-v0", num_envs=2, overrides=FREE)
    assert venv.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, _ = venv.reset(seed=3)
    assert observation.shape == (2, 279) and venv.observation_space.contains(observation)
    for t in range(STEPS):
        observation, _, terminated, truncated, info = venv.step(np.zeros((2, 51), np.float32))
        assert truncated.all() == (t == STEPS - 1) and not terminated.any()
    assert info["_final_obs"].all() and not np.array_equal(info["final_obs"], observation)
    assert np.all(observation[:, :6] == 0.0)
    venv.close()


def test_an_ended_episode_is_still_there_to_be_seen(env):
    env.reset(seed=1)
    bare, truncated = env.unwrapped, False
    while not truncated:
        before = bare.state.joints_W[0, 0].copy()
        observation, _, terminated, truncated, _ = bare.step(np.zeros(51))
        assert not terminated
    # An approach ends centimetres away from its start, so a small distance shows that no episode has begun.
    assert np.linalg.norm(bare.state.joints_W[0, 0] - before) < 0.005
    assert bare.state.episode_time[0] == 1.0
    assert np.isfinite(observation).all()


def test_actions_of_another_shape_are_refused(env):
    env.reset(seed=1)
    for action in (np.zeros(1), np.zeros(()), np.zeros((1, 51))):
        with pytest.raises(ValueError, match=r"expected \(51,\)"):
            env.unwrapped.step(action)


def test_another_pool_is_refused():
    with pytest.raises(ConfigError, match=r"pool\.kind"):
        gymnasium.make_vec("dgrasp/Grasp-v0", num_envs=1, pool="nope")


def test_labels_repeat_where_there_are_more_environments():
    words = [*FREE, "labels.limit_per_object=2"]
    venv = GraspVectorEnv(3, overrides=words)
    observation, info = venv.reset(seed=0)
    assert info["label"][0] == info["label"][2] != info["label"][1]
    assert info["object"].tolist() == ["004_sugar_box"] * 3 and info["inertia"].tolist() == ["true"] * 3
    # The same grasp, from another start.
    assert not np.array_equal(observation[0], observation[2])
    venv.close()
    with pytest.raises(ConfigError, match="num_envs 0: expected 1 or more"):
        GraspVectorEnv(0, overrides=words)


def test_gymnasiums_own_vector_has_different_labels():
    venv = gymnasium.make_vec("dgrasp/Grasp-v0", num_envs=3, vectorization_mode="sync", overrides=FREE)
    _, info = venv.reset(seed=7)
    labels = venv.envs[0].unwrapped._all.labels
    assert len(labels) > 9 and info["label"].tolist() == [labels[k].name for k in (7, 8, 9)]
    _, info = venv.reset()
    assert info["label"].tolist() == [labels[k].name for k in (7, 8, 9)]
    venv.close()


def test_an_action_is_the_residual_over_the_scale(env):
    """A published policy's actions come through to the bit, those beyond the space too."""
    residual = np.linspace(-9.0, 9.0, 51, dtype=np.float32) * np.float32(1.1)
    seen = []
    bare = env.unwrapped
    bare.reset(seed=1)
    step = bare._pool.step
    bare._pool.step = lambda actions: seen.append(actions.copy()) or step(actions)
    bare.step(residual / np.float32(ACTION_SCALE))
    bare._pool.step = step
    assert np.array_equal(seen[0], residual[None])
    assert env.action_space.high.tolist() == [1.0] * 51


HOLD = ["env.hold.first_step=8", "env.hold.last_step=12"]


def test_success_is_told_where_episodes_have_a_hold():
    # Nothing grasps the box; it drops soon after the table has gone.
    made = GraspGymEnv(overrides=[*FREE, *HOLD], label=0)
    made.reset(seed=1)
    ended = False
    while not ended:
        _, _, terminated, truncated, info = made.step(-np.ones(51, np.float32))
        ended = terminated or truncated
        assert ("is_success" in info) == ended
    assert terminated and info["is_success"] is False
    made.close()
    venv = GraspVectorEnv(2, overrides=[*FREE, *HOLD, "env.hold.drop=9.0"])
    venv.reset(seed=1)
    for _ in range(STEPS):
        _, _, _, truncated, info = venv.step(np.zeros((2, 51), np.float32))
    # Nothing falls by 9 m in an episode, so that all are held to the end.
    assert truncated.all() and info["is_success"].all() and info["_is_success"].all()
    venv.close()


def test_next_step_autoreset_shows_the_end_and_then_the_new_episode():
    same = GraspVectorEnv(2, overrides=FREE)
    following = GraspVectorEnv(2, overrides=FREE, autoreset_mode=AutoresetMode.NEXT_STEP)
    assert following.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    first = [venv.reset(seed=3)[0] for venv in (same, following)]
    assert np.array_equal(*first)
    still = np.zeros((2, 51), np.float32)
    for _ in range(STEPS):
        a, b = same.step(still), following.step(still)
    assert b[3].all() and "final_obs" not in b[4]
    assert np.array_equal(b[0], a[4]["final_obs"]) and np.array_equal(b[1], a[1])
    # The action after an end is passed over.
    a, b = same.step(still), following.step(still + 1.0)
    assert np.array_equal(a[0], b[0]) and b[1].tolist() == [0.0, 0.0] and not (b[2] | b[3]).any()
    a, b = same.step(still), following.step(still)
    assert np.array_equal(a[0], b[0]) and np.array_equal(a[1], b[1])
    same.close()
    following.close()
    with pytest.raises(ConfigError, match="expected AutoresetMode"):
        GraspVectorEnv(1, overrides=FREE, autoreset_mode=AutoresetMode.DISABLED)


def test_a_loaded_policy_acts_in_the_space():
    policy = dgrasp.load_policy("pretrained")
    made = GraspGymEnv(cfg=policy.config, overrides=["data=free", "labels.objects=004_sugar_box"], label=0)
    observation, _ = made.reset(seed=0)
    actions = policy(np.stack([observation, observation]))
    assert actions.shape == (2, 51) and np.allclose(actions[1], policy(observation), atol=1e-5)
    expected = policy._policy.act(observation[None])[0]
    single = policy(observation)
    assert np.array_equal(single * np.float32(ACTION_SCALE), expected) and made.action_space.contains(actions[0])
    made.close()
    with pytest.raises(DataError, match=r"none\.pt: no such file"):
        dgrasp.load_policy("none.pt")


def test_all_environments_act_whatever_an_epoch_of_training_draws():
    growing = ["labels.per_epoch=1", "labels.doubles_every=1", "env.lengthens_by=9"]
    venv = GraspVectorEnv(3, overrides=[*FREE, *growing])
    observation, _ = venv.reset(seed=0)
    assert observation.any(axis=1).all()
    # Episodes do not lengthen either.
    for _ in range(3):
        for _ in range(STEPS):
            _, _, _, truncated, _ = venv.step(np.zeros((3, 51), np.float32))
        assert truncated.all()
    venv.close()


def test_overrides_are_laid_over_a_config_too():
    venv = GraspVectorEnv(1, cfg=load_config(None, FREE), overrides=["labels.objects=[025_mug]"])
    assert venv._pool.labels[0].object_id == "025_mug"
    venv.close()
    with pytest.raises(ConfigError, match=r"labels\.object: unknown key"):
        GraspVectorEnv(1, cfg=load_config(None, FREE), overrides=["labels.object=[025_mug]"])


def test_a_broken_simulation_ends_with_the_last_sound_observation(env):
    before, _ = env.reset(seed=2)
    nonsense = np.full(51, np.nan, np.float32)
    observation, reward, terminated, _, _ = env.unwrapped.step(nonsense)
    assert terminated and reward == 0.0 and np.array_equal(observation, before)
    venv = gymnasium.make_vec("dgrasp/Grasp-v0", num_envs=2, overrides=FREE)
    first = venv.reset(seed=3)[0]
    actions = np.zeros((2, 51), np.float32)
    actions[1] = np.nan
    observation, _, terminated, _, info = venv.step(actions)
    assert terminated.tolist() == [False, True] == info["_final_obs"].tolist()
    assert np.array_equal(info["final_obs"][1], first[1]) and not np.array_equal(observation[1], first[1])
    venv.close()
