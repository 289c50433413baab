"""Worlds that step side by side in threads equal those that step in turn; on MuJoCo threads are the default."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from dgrasp.config.experiment import load_config
from dgrasp.errors import ConfigError
from dgrasp.pool import make_pool, pool_kind
from dgrasp.pool.process import ProcessPool
from dgrasp.pool.serial import SerialPool
from dgrasp.types import Array
from raisim_like.engines import steps_in_threads
from raisim_like.engines.mujoco.world import MujocoWorld
from tests.pool.runs import EPISODE, SHORT, random_actor, run
from tests.scenes import make_spec

LABELS = 5
MUJOCO = [*SHORT, "engine=mujoco"]


@pytest.fixture(scope="module")
def serial() -> Iterator[SerialPool]:
    pool = SerialPool(make_spec(LABELS, MUJOCO))
    yield pool
    pool.close()


@pytest.fixture(scope="module", params=[2, 4])
def threads(request: pytest.FixtureRequest) -> Iterator[SerialPool]:
    pool = SerialPool(make_spec(LABELS, MUJOCO), request.param)
    yield pool
    pool.close()


def collected(pool: SerialPool) -> dict[str, Array]:
    return {k: v.copy() for k, v in vars(pool.collect(random_actor(), 4, EPISODE, lambda n: None)).items()}


def test_steps_and_phases_are_the_same_to_the_bit(serial: SerialPool, threads: SerialPool) -> None:
    for mode in ("train", "test"):
        for ours, reference in zip(run(threads, mode), run(serial, mode), strict=True):
            assert ours.tobytes() == np.ascontiguousarray(reference).tobytes()


def test_a_collection_is_the_same_to_the_bit(serial: SerialPool, threads: SerialPool) -> None:
    reference = collected(serial)
    assert reference["truncated"].sum() == LABELS
    for name, array in collected(threads).items():
        assert array.tobytes() == reference[name].tobytes(), name


def test_each_world_steps_once_and_in_more_than_one_thread(
    threads: SerialPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    import threading

    barrier, step, seen = threading.Barrier(2, timeout=20), MujocoWorld.step, []

    def recorded(world: MujocoWorld, substeps: int) -> None:
        # The first two worlds wait for each other, so they must be in different threads.
        if len(seen) < 2:
            seen.append((world, threading.get_ident()))
            barrier.wait()
        else:
            seen.append((world, threading.get_ident()))
        step(world, substeps)

    threads.reset(3)
    monkeypatch.setattr(MujocoWorld, "step", recorded)
    threads.step(np.zeros((LABELS, 51), np.float32))
    assert len(seen) == LABELS and len({id(world) for world, _ in seen}) == LABELS
    assert len({ident for _, ident in seen}) >= 2


def test_an_error_of_a_world_arrives(threads: SerialPool, monkeypatch: pytest.MonkeyPatch) -> None:
    threads.reset(3)
    broken, step = threads.env.worlds.batch.worlds[3].engine_world, MujocoWorld.step  # type: ignore[attr-defined]

    def fail(world: MujocoWorld, substeps: int) -> None:
        if world is broken:
            raise ZeroDivisionError
        step(world, substeps)

    monkeypatch.setattr(MujocoWorld, "step", fail)
    with pytest.raises(ZeroDivisionError):
        threads.step(np.zeros((LABELS, 51), np.float32))


def test_timing_counts_the_threads(threads: SerialPool) -> None:
    collected(threads)
    timing = threads.timing()
    assert timing["workers"] in (2.0, 4.0) and 0.0 < timing["physics_share"] <= 1.0
    assert timing["physics_share"] == pytest.approx(timing["physics_s"] / timing["wall_s"] / timing["workers"], rel=0.2)


def test_auto_takes_threads_on_mujoco_and_processes_elsewhere() -> None:
    spec = make_spec(3, ["engine=mujoco", "pool.workers=2"])
    assert spec.config.pool.kind == "auto"
    pool = make_pool(spec)
    if steps_in_threads("mujoco"):
        assert pool_kind(spec.config) == "thread" and isinstance(pool, SerialPool) and pool.env.threads == 2
    else:
        assert pool_kind(spec.config) == "process" and isinstance(pool, ProcessPool)
    pool.close()
    assert pool_kind(load_config(None, ["engine=pybullet"])) == "process"


def test_there_are_no_more_threads_than_labels() -> None:
    pool = make_pool(make_spec(1, ["engine=mujoco", "pool.kind=thread", "pool.workers=8"]))
    assert isinstance(pool, SerialPool) and pool.env.threads == 1
    pool.close()


def test_threads_are_refused_on_pybullet() -> None:
    with pytest.raises(ConfigError, match=r"pool\.kind: PyBullet cannot step worlds in threads; expected auto"):
        pool_kind(load_config(None, ["pool.kind=thread", "engine=pybullet"]))
