"""Simulations that break: their episode ends and is reported; no other environment is affected."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from dgrasp.env.grasp_env import GraspEnv
from dgrasp.rl.collect import Actor, Trajectories, collect
from dgrasp.scene.scene import OBJECT
from dgrasp.scene.worlds import MAX_FALL, MAX_SPEED
from dgrasp.types import Array
from raisim_like.loop import LoopBatch
from tests.env.build import actions, label, make_env

QUICK = ["physics.substeps=2"]


def fail_once(env: GraspEnv, row: int, fault: tuple[str, float]) -> None:
    """Make the physics of one world fail in the next step."""
    batch, (where, value) = env.worlds.batch, fault
    state, advance = batch.state, batch.advance

    def failing(rows: Sequence[int], targets: Array, substeps: int) -> None:
        advance(rows, targets, substeps)
        {"gc": state.gc, "gv": state.gv, "object": state.bodies[:, OBJECT]}[where][row, 8] = value
        batch.advance = advance  # type: ignore[method-assign]

    batch.advance = failing  # type: ignore[method-assign]


FAULTS = [
    ("gc", np.nan), ("gc", np.inf), ("gv", np.inf), ("object", np.nan), ("object", 2 * MAX_SPEED), ("object", 1e300),
]  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_broken_simulation_ends_its_own_episode(fault: tuple[str, float]) -> None:
    faulty = make_env(2, first=5, overrides=QUICK)
    sound = make_env(2, first=5, overrides=QUICK)
    faulty.reset(0)
    sound.reset(0)
    for t in range(5):
        if t == 2:
            fail_once(faulty, 1, fault)
        before = faulty.o.observation[1].copy()
        out, expected = faulty.step(actions(2, t)), sound.step(actions(2, t))
        assert out.terminated.tolist() == [False, t == 2] and not out.truncated.any()
        for array in (out.observation, out.final_observation, out.reward, out.reward_terms):
            assert np.isfinite(array).all()
        # The other environment is not affected.
        assert np.array_equal(out.observation[0], expected.observation[0]) and out.reward[0] == expected.reward[0]
        if t == 2:
            assert out.reward[1] == 0.0 and not out.reward_terms[1].any()
            assert faulty.clock.tolist() == [3, 0]
            assert np.array_equal(faulty.s.object_pos_W[1], faulty.s.object_start_W[1])
            # The last valid observation of the broken episode, not the first of the next one.
            assert np.array_equal(out.final_observation[1], before)
            assert not np.array_equal(out.observation[1], before)
    (event,) = faulty.events
    assert "env 6" in event and label(6).name in event and "step 3" in event
    faulty.close()
    sound.close()


def test_what_a_broken_episode_ends_with_is_nothing_to_learn_from() -> None:
    """The learner uses final observations of truncated episodes only, so these arrays hold none of broken episodes."""
    steps = 6
    env = make_env(2, overrides=[*QUICK, f"env.episode_steps={steps}", "env.grasp_steps=1"])
    out = Trajectories.allocate(steps, 2, env.observation_size, env.action_size, len(env.reward_terms))
    layer = (np.zeros((51, env.observation_size), np.float32), np.zeros(51, np.float32))
    actor, made = Actor((layer,), np.full(51, 0.5, np.float32), 5), []

    def count(_: int) -> None:
        made.append(1)
        if len(made) == 3:
            fail_once(env, 1, ("gc", np.nan))

    collect(env, actor, 1, [0, 1], out, count)
    assert out.terminated[:, 1].tolist() == [False, False, False, True, False, False] and not out.truncated[:, 1].any()
    assert out.truncated[:, 0].tolist() == [False] * 5 + [True]
    assert out.final_observations[:, 0].any() and not out.final_observations[:, 1].any()
    env.close()


def test_a_long_fall_past_the_table_is_no_broken_simulation() -> None:
    env = make_env(1, overrides=QUICK)
    env.reset(0, "test")
    batch, fall = env.worlds.batch, 0.0
    advance = batch.advance

    def fallen(rows: Sequence[int], targets: Array, substeps: int) -> None:
        """Advance, then put the object far below the table."""
        advance(rows, targets, substeps)
        batch.state.bodies[0, OBJECT, [2, 9]] = -200.0, -fall

    batch.advance = fallen  # type: ignore[method-assign]
    for speed, broken in ((2 * MAX_SPEED, False), (2 * MAX_FALL, True)):
        fall = speed
        assert env.step(actions(1, 0)).broken.tolist() == [broken]
    env.close()


def test_a_world_full_of_nan_is_replaced() -> None:
    """The engine itself breaks and keeps NaN in all its state."""
    env = make_env(2, overrides=QUICK)
    env.reset(0)
    batch = env.worlds.batch
    assert isinstance(batch, LoopBatch)
    world = batch.worlds[1]
    world.engine_world.set_feed_forward(world.objects[0].id, np.full(51, np.nan))
    assert env.step(actions(2, 0)).terminated.tolist() == [False, True]
    assert batch.worlds[1] is not world
    for t in range(3):
        out = env.step(actions(2, t))
        assert not out.terminated.any() and np.isfinite(out.observation).all()
    assert len(env.events) == 1
    env.close()


def test_a_broken_test_episode_stays_out_until_the_next_reset() -> None:
    env = make_env(2, overrides=QUICK)
    env.reset(0, mode="test")
    env.step(actions(2, 0))
    fail_once(env, 0, ("gc", np.nan))
    assert env.step(actions(2, 1)).terminated.tolist() == [True, False]
    assert env.alive.tolist() == [False, True]
    env.remove_table()
    for t in range(2, 4):
        out = env.step(actions(2, t))
        assert not out.terminated.any() and np.isfinite(out.observation).all()
    assert env.clock.tolist() == [0, 4] and len(env.events) == 1
    env.reset(0, mode="test")
    assert env.alive.all()
    reference = make_env(2, overrides=QUICK)
    reference.reset(0, mode="test")
    assert np.array_equal(env.step(actions(2, 0)).observation, reference.step(actions(2, 0)).observation)
    env.close()
    reference.close()
