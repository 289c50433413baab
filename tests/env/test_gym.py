"""The Gymnasium interface passes Gymnasium's own checker and declares its autoreset correctly."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from dgrasp.config.experiment import load_config
from dgrasp.errors import ConfigError
from dgrasp.gym import GraspVectorEnv

FREE = ["data=free", "labels.objects=[004_sugar_box]", "env.episode_steps=62"]


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make("dgrasp/Grasp-v0", overrides=FREE, render_mode="rgb_array")
    yield made
    made.close()


def test_gymnasiums_checker_is_satisfied(env):
    with warnings.catch_warnings():
        # The checker recommends actions within [-1, 1]; ours are dimensionless residuals without such a bound.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized space.*")
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
    for t in range(62):
        _, reward, terminated, truncated, info = env.step(np.zeros(51, np.float32))
        assert not terminated and truncated == (t == 61)
        assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=1e-5)


def test_vector_env_restarts_in_the_same_step():
    venv = gymnasium.make_vec("dgrasp/Grasp-v0", num_envs=2, overrides=FREE)
    assert venv.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, _ = venv.reset(seed=3)
    assert observation.shape == (2, 279) and venv.observation_space.contains(observation)
    for t in range(62):
        observation, _, terminated, truncated, info = venv.step(np.zeros((2, 51), np.float32))
        assert truncated.all() == (t == 61) and not terminated.any()
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


def test_more_environments_than_labels_are_refused():
    with pytest.raises(ConfigError, match="one environment per label"):
        gymnasium.make_vec("dgrasp/Grasp-v0", num_envs=999, overrides=FREE)


def test_all_environments_act_whatever_an_epoch_of_training_draws():
    growing = ["labels.per_epoch=1", "labels.doubles_every=1", "env.lengthens_by=9"]
    venv = GraspVectorEnv(3, overrides=[*FREE, *growing])
    observation, _ = venv.reset(seed=0)
    assert observation.any(axis=1).all()
    # Episodes do not lengthen either.
    for _ in range(3):
        for _ in range(62):
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
