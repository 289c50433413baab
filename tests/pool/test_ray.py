"""The pool on a Ray cluster: equal to the serial one to the bit, and complete again after workers die."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dgrasp.config.experiment import load_config
from dgrasp.errors import ConfigError
from dgrasp.pool import make_pool
from dgrasp.pool.ray import RayPool
from dgrasp.pool.serial import SerialPool
from dgrasp.rl.collect import Actor
from dgrasp.rl.runner import Runner
from dgrasp.types import Array
from tests.scenes import make_spec

ray = pytest.importorskip("ray")
QUICK = ["env.episode_steps=65", "physics.substeps=2", "pool.kind=ray", "pool.workers=2",
         "pool.patience=1e3"]  # fmt: skip


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a cluster of two nodes, with one core each, on this machine."""
    from ray.cluster_utils import Cluster

    os.environ.update({"RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"})
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    made.add_node(num_cpus=1)
    ray.init(address=made.address, log_to_driver=False)
    yield made.address
    ray.shutdown()
    made.shutdown()


def _actor() -> Actor:
    rng = np.random.default_rng(0)
    layer = (rng.normal(size=(51, 279)).astype(np.float32) / 50, rng.normal(size=51).astype(np.float32))
    return Actor((layer,), np.full(51, 0.5, np.float32), 5)


def _collected(pool: Any, epoch: int) -> dict[str, Array]:
    return {k: v.copy() for k, v in vars(pool.collect(_actor(), epoch, 65, lambda n: None)).items()}


@pytest.fixture(scope="class")
def started(cluster: str) -> Iterator[tuple[Any, str]]:
    """A pool of three labels on two workers, and what was said while it waited for them."""
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stderr(io.StringIO()) as said:
        # The workers' imports take longer than this, so the message that tells the user about the waiting appears.
        patch.setattr("dgrasp.pool.ray._SAY_AFTER_S", 0.0)
        pool = make_pool(make_spec(3, QUICK))
    yield pool, said.getvalue()
    pool.close()


@pytest.fixture
def pool(started: tuple[Any, str]) -> Any:
    """The pool of `started`, whose earlier events have been read."""
    started[0].drain_events()
    return started[0]


class TestOnePool:
    """Tests of one pool. It takes the cluster's cores, so it is closed before other tests make theirs."""

    def test_a_cluster_gives_what_one_process_gives(self, started: tuple[Any, str]) -> None:
        (pool, said), serial = started, SerialPool(make_spec(3, QUICK))
        assert "waiting for 2 of 2 workers" in said
        nodes = {ray.get(member.process_id.remote()) for member in pool._members}
        assert len(nodes) == 2, "one worker per node, because each has one core"
        theirs, ours = _collected(serial, 5), _collected(pool, 5)
        for name, array in theirs.items():
            assert array.tobytes() == ours[name].tobytes(), name
        assert 0.0 < pool.timing()["physics_share"] < 1.0
        rng = np.random.default_rng(1)
        seen = [[one.reset(3, "test").copy()] for one in (serial, pool)]
        for t in range(4):
            if t == 2:
                serial.remove_table()
                pool.remove_table()
            actions = rng.normal(size=(3, 51)).astype(np.float32)
            for one, log in zip((serial, pool), seen, strict=True):
                step = one.step(actions)
                parts = (step.observation, step.reward, one.state.gc, one.state.table_contact)
                log += [part.copy() for part in parts]
        assert all(np.array_equal(a, b) for a, b in zip(*seen, strict=True))
        serial.close()

    def test_a_test_reports_unstable_simulations_and_the_time_in_the_engine(self, pool: Any) -> None:
        """As in the process pool, reports also come from the steps and phases of a test, not only from collections."""
        serial = SerialPool(make_spec(3, QUICK))
        for one in (serial, pool):
            one.reset(3, "test")
            actions = np.zeros((3, 51), np.float32)
            one.step(actions)
            actions[1] = np.nan
            assert one.step(actions).broken.tolist() == [False, True, False]
            one.remove_table()
            one.step(np.zeros((3, 51), np.float32))
        (event,) = pool.drain_events()
        assert [event] == serial.drain_events() and "env 1" in event and "step 2" in event
        assert pool.drain_events() == []
        timing = pool.timing()
        assert 0.0 < timing["physics_s"] < timing["wall_s"] * timing["workers"] and 0.0 < timing["physics_share"] < 1.0
        # Another reset restarts the count, and no time is counted twice.
        before = timing["physics_s"]
        pool.reset(3, "test")
        assert pool.timing()["physics_s"] < before
        serial.close()

    def test_a_killed_worker_is_started_again_and_its_experience_dropped(self, pool: Any) -> None:
        reference, before = _collected(pool, 4), pool.timing()["lost_workers"]
        victim = ray.get(pool._members[1].process_id.remote())
        os.kill(victim, signal.SIGKILL)
        got = _collected(pool, 4)
        assert got["valid"].tolist() == [True, False, True]
        assert np.array_equal(got["reward"][:, [0, 2]], reference["reward"][:, [0, 2]])
        assert any("worker 1 died" in event for event in pool.drain_events())
        again = _collected(pool, 4)
        assert again["valid"].all() and np.array_equal(again["reward"], reference["reward"])
        assert pool.timing()["lost_workers"] == before + 1.0

    def test_a_run_with_a_killed_worker_makes_all_its_updates(
        self, pool: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        config = load_config(None, [*QUICK, "ppo.epochs=4", "ppo.minibatches=1", "ppo.hidden=[8]"])
        collect, before = pool.collect, pool.timing()["lost_workers"]

        def strike(actor: Actor, epoch: int, *rest: Any) -> Any:
            if epoch == 2:
                os.kill(ray.get(pool._members[0].process_id.remote()), signal.SIGKILL)
            return collect(actor, epoch, *rest)

        monkeypatch.setattr(pool, "collect", strike)
        Runner(pool, config, tmp_path, {}).learn()
        with open(tmp_path / "progress.csv", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        assert [row["epoch"] for row in rows] == ["1", "2", "3", "4"]
        assert float(rows[-1]["lost_workers"]) == before + 1.0


def test_a_late_worker_is_left_behind_and_comes_back(cluster: str) -> None:
    pool = make_pool(make_spec(3, [*QUICK[:-1], "pool.patience=2.0"]))
    reference = _collected(pool, 4)
    sleeper = ray.get(pool._members[0].process_id.remote())  # type: ignore[attr-defined]
    os.kill(sleeper, signal.SIGSTOP)
    got = _collected(pool, 4)
    assert got["valid"].tolist() == [False, True, False]
    assert any("worker 0 is late" in event for event in pool.drain_events())
    os.kill(sleeper, signal.SIGCONT)
    ray.wait([pool._late[0][0]], timeout=60)  # type: ignore[attr-defined]
    again = _collected(pool, 4)
    assert again["valid"].all() and np.array_equal(again["reward"], reference["reward"])
    pool.close()


def test_more_workers_than_the_cluster_has_cores_are_refused(cluster: str) -> None:
    with pytest.raises(ConfigError, match=r"pool\.workers: 3 workers need one CPU each, but the Ray cluster has 2"):
        make_pool(make_spec(3, [*QUICK, "pool.workers=3"]))
    # There is at most one worker per label, so only one of these three is made.
    make_pool(make_spec(1, [*QUICK, "pool.workers=3"])).close()


def test_a_pool_that_cannot_start_leaves_nothing_behind(cluster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends its workers and the cluster that it started for itself."""
    members: list[Any] = []
    shut: list[str] = []
    ready = RayPool._await_ready

    def interrupt(pool: RayPool) -> None:
        ready(pool)
        members.extend(pool._members)
        raise KeyboardInterrupt

    monkeypatch.setattr(RayPool, "_await_ready", interrupt)
    monkeypatch.setattr(RayPool, "_connect", lambda pool: None)
    monkeypatch.setattr(ray, "shutdown", lambda: shut.append("shutdown"))
    with monkeypatch.context() as alone, pytest.raises(KeyboardInterrupt):
        alone.setattr(ray, "is_initialized", iter([False, *[True] * 1000]).__next__)
        make_pool(make_spec(2, QUICK))
    assert shut == ["shutdown"] and len(members) == 2
    for member in members:
        with pytest.raises(ray.exceptions.RayActorError):
            # Ray ends a worker with some delay; until then the worker answers.
            for _ in range(600):
                ray.get(member.process_id.remote(), timeout=60)
                time.sleep(0.1)


def test_no_cluster_at_an_address_is_one_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray, "is_initialized", lambda: False)

    def refuse(**_: Any) -> None:
        raise ConnectionError("nobody there")

    monkeypatch.setattr(ray, "init", refuse)
    with pytest.raises(ConfigError, match=r"pool\.address: cannot reach a Ray cluster at 'localhost:1'"):
        make_pool(make_spec(1, [*QUICK, "pool.address='localhost:1'"]))


def test_ray_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    import builtins

    real = builtins.__import__

    def missing(name: str, *arguments: Any, **words: Any) -> Any:
        if name == "ray":
            raise ImportError(name)
        return real(name, *arguments, **words)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ConfigError, match=r"pip install 'dgrasp\[ray\]'"):
        make_pool(make_spec(1, QUICK))
    assert load_config(None, QUICK).pool.kind == "ray"
