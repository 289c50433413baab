"""The thread pool equals the serial one, to the bit, for any division of the labels; on MuJoCo it is the default."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from dgrasp.config.experiment import load_config
from dgrasp.errors import ConfigError, DataError
from dgrasp.pool import make_pool, pool_kind, thread
from dgrasp.pool.base import Pool
from dgrasp.pool.process import ProcessPool
from dgrasp.pool.serial import SerialPool
from dgrasp.pool.thread import ThreadPool
from dgrasp.types import Array
from raisim_like.engines import steps_in_threads
from tests.pool.runs import EPISODE, SHORT, random_actor, run
from tests.scenes import make_spec

MUJOCO = [*SHORT, "engine=mujoco"]


@pytest.fixture(scope="module")
def serial() -> Iterator[SerialPool]:
    pool = SerialPool(make_spec(3, MUJOCO))
    yield pool
    pool.close()


@pytest.fixture(scope="module", params=[1, 2, 3])
def threads(request: pytest.FixtureRequest) -> Iterator[ThreadPool]:
    pool = ThreadPool(make_spec(3, MUJOCO), request.param)
    yield pool
    pool.close()


def collected(pool: Pool, epoch: int = 4) -> dict[str, Array]:
    return {k: v.copy() for k, v in vars(pool.collect(random_actor(), epoch, EPISODE, lambda n: None)).items()}


def test_steps_and_phases_equal_serial_to_the_bit(serial: SerialPool, threads: ThreadPool) -> None:
    for mode in ("train", "test"):
        for ours, reference in zip(run(threads, mode), run(serial, mode), strict=True):
            assert ours.tobytes() == np.ascontiguousarray(reference).tobytes()


def test_a_collection_equals_serial_to_the_bit_and_counts_its_steps(serial: SerialPool, threads: ThreadPool) -> None:
    told: list[int] = []
    threads.collect(random_actor(), 1, EPISODE, told.append)
    assert sum(told) == 3 * EPISODE
    reference = collected(serial)
    assert reference["truncated"].sum() == 3
    for name, array in collected(threads).items():
        assert array.tobytes() == reference[name].tobytes(), name
    assert 0.0 < threads.timing()["physics_share"] < 1.0


def test_a_new_division_changes_no_result(serial: SerialPool, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first collection the first label is said to cost as much as the others together."""
    monkeypatch.setattr(thread, "costs", lambda seconds, steps: np.array([2.0, 1.0, 1.0]))
    pool = ThreadPool(make_spec(3, MUJOCO), 2)
    assert pool._rows == [slice(0, 3, 2), slice(1, 3, 2)]
    collected(pool, 3)
    spent = pool._spent
    reference = collected(serial)
    for name, array in collected(pool).items():
        assert array.tobytes() == reference[name].tobytes(), name
    assert pool._rows == [slice(0, 1), slice(1, 3)]
    # Costs go on from those of the worlds that were replaced.
    assert (pool._spent[1] == spent[1] + EPISODE).all() and (pool._spent[0] > spent[0]).all()
    pool.close()


@pytest.mark.parametrize("threads", [2], indirect=True)
def test_an_interrupted_collection_leaves_the_pool_usable(serial: SerialPool, threads: ThreadPool) -> None:
    def interrupt(steps: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        threads.collect(random_actor(), 1, 10 * EPISODE, interrupt)
    made = threads._spent[1].copy()
    reference = collected(serial)
    assert collected(threads)["last_observation"].tobytes() == reference["last_observation"].tobytes()
    # The interrupted threads had stopped.
    assert (threads._spent[1] == made + EPISODE).all()


@pytest.mark.parametrize("threads", [2], indirect=True)
def test_an_error_in_one_thread_ends_the_collection(threads: ThreadPool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads._envs[1], "step", lambda actions: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        threads.collect(random_actor(), 1, 100 * EPISODE, lambda n: None)
    monkeypatch.undo()
    assert collected(threads)["valid"].all()


def test_an_observation_that_is_not_finite_is_named_as_in_serial(
    threads: ThreadPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    env = threads._envs[0]
    step = env.step

    def spoil(actions: Array) -> Any:
        made = step(actions)
        made.observation[0, 5] = np.nan
        return made

    monkeypatch.setattr(env, "step", spoil)
    with pytest.raises(DataError, match="environment 0, epoch 2, step 1: the observation, entry 5, is nan"):
        threads.collect(random_actor(), 2, EPISODE, lambda n: None)


def test_auto_takes_threads_on_mujoco_and_processes_elsewhere() -> None:
    for engine, kind, cls in (("mujoco", "thread", ThreadPool), ("pybullet", "process", ProcessPool)):
        if engine == "pybullet":
            pytest.importorskip("pybullet")
        elif not steps_in_threads(engine):
            kind, cls = "process", ProcessPool
        spec = make_spec(1, [f"engine={engine}", "pool.workers=1"])
        assert spec.config.pool.kind == "auto" and pool_kind(spec.config) == kind
        pool = make_pool(spec)
        assert isinstance(pool, cls)
        pool.close()


def test_threads_are_refused_on_pybullet() -> None:
    with pytest.raises(ConfigError, match=r"pool\.kind: PyBullet cannot step worlds in threads; expected auto"):
        pool_kind(load_config(None, ["pool.kind=thread", "engine=pybullet"]))
