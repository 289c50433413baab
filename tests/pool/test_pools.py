"""The process pool equals the serial one, to the bit, for any division of the labels."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

from dgrasp.env.grasp_env import GraspEnv
from dgrasp.pool import PoolError, WorkerLost, make_pool
from dgrasp.pool.process import ProcessPool
from dgrasp.pool.serial import SerialPool
from dgrasp.scene.worlds import Worlds
from tests.pool.mortal import Mortal
from tests.pool.runs import EPISODE, SHORT, random_actor, run
from tests.scenes import make_spec


@pytest.fixture(scope="module")
def serial():
    pool = SerialPool(make_spec(3, SHORT))
    yield pool
    pool.close()


@pytest.fixture(scope="module", params=[1, 2])
def parallel(request):
    """A pool of one worker, then one of two."""
    pool = ProcessPool(make_spec(3, SHORT), request.param)
    yield pool
    pool.close()


@pytest.fixture(scope="module")
def mortal():
    """A pool of two workers whose workers are lost; each loss must leave it as good as new for the next test."""
    pool = ProcessPool(make_spec(3, [*SHORT, "pool.hang_s=4"]), 2)
    yield pool
    pool.close()


def test_process_pool_equals_serial_to_the_bit(serial, parallel):
    for mode in ("train", "test"):
        for ours, reference in zip(run(parallel, mode), run(serial, mode), strict=True):
            assert ours.tobytes() == np.ascontiguousarray(reference).tobytes()


def test_collecting_is_the_same_to_the_bit_however_the_labels_are_divided(serial, parallel):
    reference = {k: v.copy() for k, v in vars(serial.collect(random_actor(), 4, EPISODE, lambda n: None)).items()}
    assert reference["truncated"][-1].all() and reference["truncated"].sum() == 3
    # The last observation of the episode is not the first of the next.
    assert not np.array_equal(reference["final_observations"][0], reference["last_observation"])
    told = []
    parallel.collect(random_actor(), 1, EPISODE, told.append)
    assert sum(told) == 3 * EPISODE
    for name, array in vars(parallel.collect(random_actor(), 4, EPISODE, told.append)).items():
        assert array.tobytes() == reference[name].tobytes(), name
    assert 0.0 < parallel.timing()["physics_share"] < 1.0


@pytest.mark.parametrize("parallel", [2], indirect=True)
def test_an_interrupted_collection_leaves_the_pool_usable(serial, parallel):
    def interrupt(steps):
        if steps:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        parallel.collect(random_actor(), 1, EPISODE, interrupt)
    observation = parallel.collect(random_actor(), 4, EPISODE, lambda n: None).last_observation
    assert np.array_equal(observation, serial.collect(random_actor(), 4, EPISODE, lambda n: None).last_observation)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_lost_worker_is_replaced_and_its_experience_dropped(serial, mortal, how):
    """One worker is killed, or stopped so that it hangs; the experience of the other worker does not change."""
    reference = {k: v.copy() for k, v in vars(serial.collect(random_actor(), 4, EPISODE, lambda n: None)).items()}
    lost_before = mortal.timing()["lost_workers"]
    t = mortal.collect(Mortal(**vars(random_actor()), how=how), 4, EPISODE, lambda n: None)
    kept = np.flatnonzero(t.valid)
    assert len(kept) == 2
    for name, array in vars(t.valid_part()).items():
        expected = reference[name][kept] if len(reference[name]) == 3 else reference[name][:, kept]
        assert np.array_equal(array, expected), name
    assert mortal.timing()["lost_workers"] == lost_before + 1.0
    (event,) = mortal.drain_events()
    assert ("died (exit code -9)" if how == signal.SIGKILL else "hung") in event and "dropped" in event
    again = mortal.collect(random_actor(), 4, EPISODE, lambda n: None)
    assert all(np.array_equal(array, reference[name]) for name, array in vars(again).items())


def test_a_worker_lost_between_steps_says_so_and_is_there_again(serial, mortal):
    """Three losses, as in a long test, with only resets and steps in between: not three in a row."""
    expected = serial.reset(3).copy()
    for mode in ("train", "train", "test"):
        observation = mortal.reset(3, mode)
        assert np.array_equal(observation, expected) == (mode == "train")
        mortal.step(np.zeros((3, 51), np.float32))
        os.kill(mortal._members[1].process.pid, signal.SIGKILL)
        with pytest.raises(WorkerLost, match=r"worker 1 died \(exit code -9\)"):
            if mode == "test":
                mortal.remove_table()
            for _ in range(100):
                mortal.step(np.zeros((3, 51), np.float32))
    assert np.array_equal(mortal.reset(3), expected)


def test_a_worker_that_never_lives_is_given_up(monkeypatch):
    pool = ProcessPool(make_spec(2), 2)
    try:
        # Every worker started from now on dies at once.
        monkeypatch.setattr("dgrasp.pool.process.work", os._exit)
        os.kill(pool._members[0].process.pid, signal.SIGKILL)
        with pytest.raises(PoolError, match="worker 0 was lost 3 times in a row"):
            pool.collect(random_actor(), 1, 195, lambda steps: None)
    finally:
        pool.close()


def test_a_broken_episode_can_be_played_again(monkeypatch):
    """An explosion in the middle of an epoch leaves an incident with the epoch and the actions that led to it."""
    pool = SerialPool(make_spec(2, SHORT))
    seen, steps = [], 0

    def explode(worlds):
        # Report an explosion of the second world once, in the 20th control step that is checked.
        nonlocal steps
        steps += 1
        if steps == 20:
            seen.append(worlds.s.gc[1].copy())
        return np.array([False, steps == 20])

    monkeypatch.setattr(Worlds, "exploded", explode)
    pool.collect(random_actor(), 4, EPISODE, lambda n: None)
    (incident,) = pool.drain_incidents()
    assert (incident.env, incident.epoch, incident.actions.shape) == (1, 4, (20, 51))
    assert pool.drain_incidents() == [] and "unstable" in pool.drain_events()[0]
    pool.close()

    spec = make_spec(2, SHORT)
    env = GraspEnv(spec.labels[1:], spec.hand, spec.objects, spec.config, indices=[incident.env])
    monkeypatch.undo()
    env.reset(incident.epoch)
    for action in incident.actions:
        env.step(action[None])
    assert np.array_equal(env.s.gc[0], seen[0])
    env.close()


def test_an_epoch_depends_on_nothing_before_it(serial):
    first = run(serial)
    run(serial, "test")
    serial.reset(9, "label")
    for _ in range(30):
        serial.step(np.zeros((3, 51), np.float32))
    again = run(serial)
    fresh_pool = SerialPool(make_spec(3, SHORT))
    fresh = run(fresh_pool)
    fresh_pool.close()
    for a, b, c in zip(first, again, fresh, strict=True):
        assert np.array_equal(a, b) and np.array_equal(a, c)


def test_timing_counts_physics(serial):
    run(serial)
    timing = serial.timing()
    assert 0.0 < timing["physics_s"] <= timing["wall_s"]
    assert timing["physics_share"] == pytest.approx(timing["physics_s"] / timing["wall_s"], rel=0.2)


def test_more_workers_than_labels_are_not_started():
    pool = ProcessPool(make_spec(1), 4)
    try:
        assert pool.timing()["workers"] == 1.0
    finally:
        pool.close()


def test_a_workers_exception_arrives_with_its_traceback():
    spec = make_spec(1)
    broken = type(spec)(spec.labels, spec.hand, {}, spec.config)
    with pytest.raises(PoolError, match=r"(?s)worker 0 failed.*Traceback.*KeyError: '004_sugar_box'"):
        ProcessPool(broken, 1)


def test_make_pool_takes_the_configs_kind():
    pool = make_pool(make_spec(1, ["pool.kind=serial"]))
    assert isinstance(pool, SerialPool)
    pool.close()
