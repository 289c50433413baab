"""The grasping environment: seeded starts, episodes and their ends, the stability test."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dgrasp.config.experiment import load_config
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.scene.scene import LOWERED_TOP, TABLE_TOP
from dgrasp.scene.worlds import Worlds
from dgrasp.types import Array
from raisim_like.loop import LoopBatch
from raisim_like.rotations import euler_from_matrix
from tests.env.build import actions, box, hand, label, make_env

SHORT = ["env.episode_steps=4", "env.grasp_steps=2"]
QUICK = ["physics.substeps=2"]
"""Two substeps per control step, for tests in which the accuracy of the physics matters little."""


@pytest.fixture
def env(engine: str) -> Iterator[GraspEnv]:
    made = make_env(2, overrides=[*QUICK, f"engine={engine}"])
    yield made
    made.close()


@pytest.fixture
def targets(monkeypatch: pytest.MonkeyPatch) -> list[Array]:
    """The PD targets given to the hands, recorded."""
    given: list[Array] = []
    advance = LoopBatch.advance

    def record(batch: LoopBatch, rows: Sequence[int], targets: Array, substeps: int) -> None:
        given.extend(targets[rows])
        advance(batch, rows, targets, substeps)

    monkeypatch.setattr(LoopBatch, "advance", record)
    return given


def test_sizes(env: GraspEnv) -> None:
    assert (env.num_envs, env.observation_size, env.action_size) == (2, 279, 51)
    observation = env.reset()
    assert observation.shape == (2, 279) and observation.dtype == np.float32 and np.isfinite(observation).all()
    out = env.step(np.zeros((2, 51), np.float32))
    assert out.observation.shape == (2, 279) and out.reward.shape == (2,) and out.terminated.dtype == bool
    assert out.reward_terms.shape == (2, len(env.reward_terms))
    assert out.reward_terms.sum(axis=1) == pytest.approx(out.reward, rel=1e-5)


def start(env: GraspEnv, epoch: int) -> Array:
    """The quantities that the noise sets: wrist positions, wrist rotations and finger angles."""
    env.reset(epoch)
    n = env.num_envs
    return np.hstack([env.s.wrist_start_W, env.s.R_WH0.reshape(n, 9), env.s.gc])


def test_noise_belongs_to_seed_epoch_and_environment(env: GraspEnv) -> None:
    first = start(env, 0)
    assert np.array_equal(start(env, 0), first)
    assert np.abs(start(env, 1) - first).max(axis=1).min() > 1e-4
    assert not np.array_equal(first[0, 18:], first[1, 18:])
    other_seed = make_env(2, overrides=[*QUICK, "seed=2", f"engine={env.config.engine}"])
    assert np.abs(start(other_seed, 0) - first).max(axis=1).min() > 1e-4
    other_seed.close()
    second_alone = make_env(1, first=1, overrides=[*QUICK, f"engine={env.config.engine}"])
    assert np.array_equal(start(second_alone, 0)[0], first[1])
    second_alone.close()


def test_noise_stays_within_its_half_widths(env: GraspEnv) -> None:
    noise, clean = env.config.env.noise, env.starts[0]
    offsets, turns, fingers = [], [], []
    for epoch in range(40):
        env.reset(epoch)
        offsets.append(env.s.wrist_start_W[0] - clean.T_WH[:3, 3])
        turns.append(euler_from_matrix(clean.T_WH[:3, :3].T @ env.s.R_WH0[0]))
        fingers.append(env.s.gc[0, 6:] - clean.hand_pose)
        assert env.s.gc[0, :6].tolist() == [0.0] * 6
    for values, half in (
        (np.array(offsets)[:, :2], noise.wrist_xy), (np.array(offsets)[:, 2], noise.wrist_z),
        (np.array(turns), noise.wrist_angle), (np.array(fingers), noise.finger_angle),
    ):  # fmt: skip
        # 40 draws or more from a uniform distribution come near both ends.
        assert 0.75 * half < values.max() <= half + 1e-12 and -half - 1e-12 <= values.min() < -0.75 * half


def test_without_noise_every_epoch_starts_alike() -> None:
    zero = [f"env.noise.{key}=0.0" for key in ("wrist_xy", "wrist_z", "wrist_angle", "finger_angle")]
    quiet = make_env(1, overrides=[*QUICK, *zero])
    first = start(quiet, 0)
    assert np.array_equal(start(quiet, 1), first)
    assert np.allclose(first[0, :3], quiet.starts[0].T_WH[:3, 3], atol=1e-15)
    quiet.close()


def test_division_into_batches_changes_nothing_to_the_bit(engine: str) -> None:
    """Two labels in one environment, and each alone: the same observations and rewards."""
    on = [f"engine={engine}"]
    together, alone = make_env(2, overrides=on), [make_env(1, i, on) for i in range(2)]
    observations = [together.reset(3).copy()]
    others = [np.vstack([one.reset(3) for one in alone])]
    for t in range(10):
        out = together.step(actions(2, t))
        observations.append(np.column_stack([out.observation, out.reward]))
        outs = [one.step(actions(1, t, i)) for i, one in enumerate(alone)]
        others.append(np.vstack([np.column_stack([one.observation, one.reward]) for one in outs]))
    for step in range(11):
        assert np.array_equal(observations[step], others[step])
    for one in (together, *alone):
        one.close()


def test_an_epoch_can_be_repeated_to_the_bit(env: GraspEnv) -> None:
    runs = []
    for _ in range(2):
        seen = [env.reset(5).copy()]
        seen += [env.step(20 * actions(2, t)).observation.copy() for t in range(6)]
        runs.append(np.array(seen))
    assert np.array_equal(runs[0], runs[1])


def test_targets_are_bias_plus_scaled_action_within_the_limits(env: GraspEnv, targets: list[Array]) -> None:
    env.reset(0)
    before = env.s.gc.copy()
    action = actions(2, 0)
    action[0, 20], action[1, 30] = 1e6, -1e6
    env.step(action)
    assert len(targets) == 2
    for i, target in enumerate(targets):
        expected = np.clip(before[i, 6:] + 0.015 * action[i, 6:], *hand().limits[6:].T)
        assert target[6:] == pytest.approx(expected, abs=1e-7)
        assert (target >= hand().limits[:, 0]).all() and (target <= hand().limits[:, 1]).all()
    assert targets[0][20] == hand().limits[20, 1]


def test_episodes_are_truncated_and_restart_at_once() -> None:
    env, longer = make_env(2, overrides=[*QUICK, *SHORT]), make_env(2, overrides=QUICK)
    env.reset(0)
    longer.reset(0)
    first_start = env.s.wrist_start_W.copy()
    for t in range(4):
        out, expected = env.step(actions(2, t)), longer.step(actions(2, t))
        assert not out.terminated.any() and out.truncated.tolist() == [t == 3] * 2
    # The observation is the first of the new episode; the final observation and the reward are those of the old one.
    assert np.array_equal(out.final_observation, expected.observation)
    assert np.array_equal(out.reward, expected.reward)
    assert env.clock.tolist() == [0, 0]
    assert out.observation[:, :6].tolist() == [[0.0] * 6] * 2
    assert np.array_equal(env.s.object_pos_W, env.s.object_start_W)
    # Every episode has new noise, drawn from the environment's own stream.
    second_start = env.s.wrist_start_W.copy()
    assert np.abs(second_start - first_start).max(axis=1).min() > 1e-5
    env.reset(0)
    for t in range(4):
        env.step(actions(2, t))
    assert np.array_equal(env.s.wrist_start_W, second_start)
    assert not env.step(actions(2, 9)).truncated.any()
    env.close()
    longer.close()


def test_a_truncated_episode_begins_anew_as_after_a_reset() -> None:
    """The first observation of the new episode contains nothing of the old one."""
    env = make_env(1, overrides=[*QUICK, *SHORT])
    env.reset(0)
    for t in range(4):
        out = env.step(40 * actions(1, t))
    state = env.s
    assert state.contact_impulse.tolist() == [[0.0] * 16] and state.contacts.tolist() == [[0.0] * 16]
    assert state.gv.tolist() == [[0.0] * 51]
    assert out.observation[0, 216:222].tolist() == [0.0] * 6 and out.observation[0, 270:273].tolist() == [0.0] * 3
    env.close()


def test_test_mode_has_no_noise_and_no_end() -> None:
    env = make_env(1, overrides=[*QUICK, *SHORT])
    env.reset(0, mode="test")
    assert np.array_equal(env.s.wrist_start_W[0], env.starts[0].T_WH[:3, 3])
    assert np.array_equal(env.s.R_WH0[0], env.starts[0].T_WH[:3, :3])
    assert np.array_equal(env.s.gc[0, 6:], env.starts[0].hand_pose)
    for t in range(6):
        out = env.step(actions(1, t))
        assert not out.truncated.any() and not out.terminated.any()
    assert env.clock.tolist() == [6]
    env.close()


def test_environments_that_are_told_to_rest_stay_as_they_are() -> None:
    env, other = (make_env(2, overrides=QUICK) for _ in range(2))
    env.reset(0, mode="test")
    other.reset(0, mode="test")
    env.step(actions(2, 0))
    other.step(actions(2, 0))
    env.rest(np.array([False, True]))
    before = env.s.gc[1].copy(), env.s.object_pos_W[1].copy()
    for t in range(1, 4):
        assert np.array_equal(env.step(actions(2, t)).observation[0], other.step(actions(2, t)).observation[0])
    assert np.array_equal(env.s.gc[1], before[0]) and np.array_equal(env.s.object_pos_W[1], before[1])
    assert env.clock.tolist() == [4, 1]
    assert np.array_equal(env.reset(0, mode="test"), other.reset(0, mode="test"))
    env.close()
    other.close()


def test_an_object_that_nobody_holds_falls_when_the_table_goes(engine: str, targets: list[Array]) -> None:
    env = make_env(1, overrides=[f"engine={engine}"])
    env.reset(0, mode="test")
    nothing = np.zeros((1, 51), np.float32)
    for _ in range(3):
        env.step(nothing)
    height = env.s.object_pos_W[0, 2]
    assert env.s.table_contact[0] and height == pytest.approx(TABLE_TOP + 0.0875, abs=1e-3)
    wrist = env.s.gc[0, :6].copy()
    env.remove_table()
    contacts = []
    for _ in range(12):
        env.step(np.ones((1, 51), np.float32))
        contacts.append(bool(env.s.table_contact[0]))
    # A fall of 0.25 m takes 0.226 s, 7.8 control steps.
    assert contacts[:7] == [False] * 7 and any(contacts[7:])
    assert env.s.object_pos_W[0, 2] == pytest.approx(LOWERED_TOP + 0.0875, abs=0.01)
    # Now the action moves only the fingers; the wrist is held where it was, with ten times the stiffness.
    assert targets[-1][:6] == pytest.approx(wrist, abs=1e-12)
    env.close()


def test_label_mode_starts_in_the_grasp_without_a_table() -> None:
    env = make_env(1, overrides=QUICK)
    env.reset(0, mode="label")
    one = env.labels[0]
    assert np.abs(env.s.joints_W[0] - one.joints_W).max() < 1e-12
    assert np.array_equal(env.s.object_pos_W[0], one.T_WO[:3, 3])
    for _ in range(5):
        env.step(np.ones((1, 51), np.float32))
    assert not env.s.table_contact[0]
    assert env.s.object_linvel_W[0, 2] < -0.15
    env.close()


def test_the_wrist_carries_the_object_where_no_table_does(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[float, bool]] = []
    tell = Worlds.set_gains

    def record(worlds: Worlds, i: int, kp_position: float, carries: bool = True) -> None:
        told.append((kp_position, carries))
        tell(worlds, i, kp_position, carries)

    monkeypatch.setattr(Worlds, "set_gains", record)
    one = make_env(1, overrides=QUICK)
    one.reset(0)
    one.reset(0, mode="test")
    one.remove_table()
    one.reset(0, mode="label")
    one.reset(0, mode="test")
    one.begin_motion(np.eye(4)[None, None])
    assert told == [(50.0, False), (50.0, False), (500.0, True), (500.0, True), (50.0, False), (500.0, True)]
    one.close()


def make_with(**changes: Any) -> GraspEnv:
    one = replace(label(), **changes)
    return GraspEnv([one], hand(), {one.object_id: box()}, load_config(None, QUICK))


def test_a_label_without_a_start_is_drawn_back() -> None:
    env = make_with(start=None)
    env.reset(0, mode="test")
    away = env.labels[0].T_WH[:3, 3] - env.labels[0].T_WO[:3, 3]
    assert np.linalg.norm(env.s.wrist_start_W[0] - env.labels[0].T_WH[:3, 3]) == pytest.approx(0.1)
    assert np.cross(env.s.wrist_start_W[0] - env.labels[0].T_WO[:3, 3], away) == pytest.approx(np.zeros(3), abs=1e-12)
    env.close()
