"""The hold in training episodes (removal of the table, control of the wrist, end by a drop), and the draw of labels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from dgrasp.env.grasp_env import GraspEnv
from tests.scenes import make_spec

HOLD = ["env.hold.first_step=4", "env.hold.last_step=9", "env.reward.hold=2", "env.episode_steps=70"]


def make(count: int, overrides: list[str]) -> GraspEnv:
    spec = make_spec(count, overrides)
    return GraspEnv(spec.labels, spec.hand, spec.objects, spec.config)


@pytest.fixture
def env() -> Iterator[GraspEnv]:
    made = make(3, HOLD)
    yield made
    made.close()


def test_the_table_goes_once_in_the_window_and_the_wrist_stays_from_then_on() -> None:
    # The hands are still far away, so the objects fall; only a drop of 10 m would end the episode.
    env = make(3, [*HOLD, "env.hold.drop=10"])
    rng = np.random.default_rng(0)
    term = env.reward_terms.index("hold")
    env.reset(1)
    gone = np.full(3, -1)
    wrist = np.zeros((3, 6))
    for t in range(20):
        before = env.s.gc[:, :6].copy()
        o = env.step(rng.normal(size=(3, 51)))
        new = (env.s.table_gone > 0) & (gone < 0)
        gone[new], wrist[new] = t, before[new]
        running = gone >= 0
        assert np.array_equal(env._target[running, :6], np.clip(wrist[running], *env._limits[:, :6]))
        assert np.array_equal(o.reward_terms[:, term], 2.0 * env.s.holding)
        assert env.s.episode_time == pytest.approx((t + 1) / 70) and not o.terminated.any()
    # Step t is the step that began after t completed steps.
    assert ((gone >= 4) & (gone <= 9)).all() and len(set(gone)) > 1
    # The actions still move the fingers.
    assert np.abs(env._target[:, 6:] - env.s.gc[:, 6:]).max() > 1e-3
    env.close()


def test_a_dropped_object_ends_the_episode_and_is_no_incident(env: GraspEnv) -> None:
    """Open hands hold nothing: a free fall of 5 cm takes 0.1 s, 3.5 control steps; then the episode restarts."""
    env.reset(1)
    flat = np.zeros((3, 51))
    flat[:, 6:] = -30.0
    ended, o = np.zeros(3, bool), None
    for _ in range(25):
        o = env.step(flat)
        for i in np.flatnonzero(o.terminated & ~ended):
            assert not o.broken[i] and not o.truncated[i]
            # The step of the drop earns no hold reward.
            assert o.reward_terms[i, env.reward_terms.index("hold")] == 0.0
            assert env.clock[i] == 0 and env.s.table_gone[i] == 0.0
        ended |= o.terminated
    assert ended.all() and env.events == []


def test_without_a_hold_the_table_stays() -> None:
    env = make(1, ["env.episode_steps=70"])
    env.reset(1)
    for _ in range(12):
        o = env.step(np.zeros((1, 51)))
    assert "hold" not in env.reward_terms and env.s.table_gone[0] == 0.0 and not o.terminated[0]
    env.close()


def test_the_same_labels_are_drawn_however_the_set_is_divided() -> None:
    spec = make_spec(4, ["labels.per_epoch=3", "env.episode_steps=70"])
    whole = GraspEnv(spec.labels, spec.hand, spec.objects, spec.config)
    half = GraspEnv(spec.labels[1::2], spec.hand, spec.objects, spec.config, [1, 3], 4)
    draws = []
    for epoch in range(6):
        whole.reset(epoch)
        half.reset(epoch)
        assert whole.active.sum() == 3 and np.array_equal(whole.active[1::2], half.active)
        draws.append(tuple(whole.active))
    # Each label is left out in some epoch.
    assert len(set(draws)) == 4
    before = whole.s.gc.copy()
    out = whole.step(np.ones((4, 51)))
    moved = np.abs(whole.s.gc - before).max(axis=1) > 0
    assert np.array_equal(moved, whole.active)
    # Active environments act and observe the same as in an epoch in which all take part.
    everyone = GraspEnv(spec.labels, spec.hand, spec.objects, make_spec(4, ["env.episode_steps=70"]).config)
    everyone.reset(5)
    other = everyone.step(np.ones((4, 51)))
    for mine, theirs in ((out.observation, other.observation), (out.reward, other.reward),
                         (out.reward_terms, other.reward_terms)):
        assert np.array_equal(mine[whole.active], theirs[whole.active]) and not mine[~whole.active].any()
    everyone.close()
    # A test uses all labels, and so does an epoch that has grown to their number.
    whole.config = make_spec(4, ["labels.per_epoch=3", "labels.doubles_every=2", "env.episode_steps=70"]).config
    whole.reset(2)
    assert whole.active.sum() == 3
    whole.reset(3)
    assert whole.active.all()
    whole.reset(0, "test")
    assert whole.active.all()
    whole.close()
    half.close()


def test_training_episodes_lengthen_and_tests_do_not_end() -> None:
    options = ["env.episode_steps=65", "env.lengthens_by=3", "labels.per_epoch=1", "labels.doubles_every=2"]
    env = make(1, [*options, "env.critic_features=true", "physics.substeps=1"])
    for epoch, length in ((2, 65), (3, 68)):
        env.reset(epoch)
        for step in range(1, length + 1):
            assert env.s.episode_time[0] == pytest.approx((step - 1) / length)
            o = env.step(np.zeros((1, 51)))
            assert o.truncated[0] == (step == length)
        assert env.clock[0] == 0
    env.reset(3, "test")
    for _ in range(70):
        o = env.step(np.zeros((1, 51)))
    assert not o.truncated[0]
    env.close()
