"""Environments in worker processes, many to a worker, over shared memory.

To collect an epoch, each worker is sent the actor once and goes through all its control steps alone; a
worker waits for nobody. Stepped from outside, one byte goes to each worker per step and one comes back.
Observations, actions and states lie in shared memory. Environment i belongs to worker i modulo the number
of workers, which spreads costly objects evenly.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np

from dgrasp.env.features import FeatureLayer
from dgrasp.env.grasp_env import GraspEnv, Mode, StepArrays
from dgrasp.env.rewards import Reward
from dgrasp.env.state import STATE_SIZE, copy_state, state_views
from dgrasp.errors import DGraspError
from dgrasp.hand.skeleton import N_DOF
from dgrasp.pool.base import PoolSpec
from dgrasp.rl.collect import Actor, Trajectories, collect
from dgrasp.rl.vec_env import Step
from dgrasp.types import Array, SceneState

_POLL_S = 0.2
"""How often the main process looks how far a collection is."""
_STEP, _QUIT = b"s", b"q"
Layout = dict[str, tuple[tuple[int, ...], Any]]
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class PoolError(DGraspError):
    """A worker failed; the message holds its traceback."""


class _Stopped(Exception):
    """The main process wants a collection to end."""


def _block(layout: Layout, name: str | None = None) -> tuple[SharedMemory, dict[str, Array]]:
    """Named arrays in one block of shared memory: a new one, or the existing one of that name."""
    sizes = {key: int(np.prod(shape)) * np.dtype(kind).itemsize for key, (shape, kind) in layout.items()}
    memory = SharedMemory(name=name) if name else SharedMemory(create=True, size=sum(sizes.values()))
    arrays, offset = {}, 0
    for key, (shape, kind) in layout.items():
        arrays[key] = np.ndarray(shape, kind, buffer=memory.buf, offset=offset)
        offset += sizes[key]
    return memory, arrays


class _Shared:
    """The arrays of all N environments for steps from outside, and what a collection needs beside them."""

    def __init__(self, n: int, observation_size: int, n_terms: int, workers: int, name: str | None = None) -> None:
        layout: Layout = {
            "state": ((n * STATE_SIZE,), np.float64),
            "counts": ((workers,), np.int64),
            "actions": ((n, N_DOF), np.float32),
            "observation": ((n, observation_size), np.float32),
            "final_observation": ((n, observation_size), np.float32),
            "reward": ((n,), np.float32),
            "reward_terms": ((n, n_terms), np.float32),
            "terminated": ((n,), np.bool_),
            "truncated": ((n,), np.bool_),
            "stop": ((1,), np.bool_),
        }
        self.memory, arrays = _block(layout, name)
        self.state: SceneState = state_views(n, arrays.pop("state"))
        self.actions: Array = arrays.pop("actions")
        self.counts: Array = arrays.pop("counts")
        """Control steps that each worker has made in this collection."""
        self.stop: Array = arrays.pop("stop")
        """Tells the workers to end a collection early."""
        self.out = StepArrays(**arrays)

    def write(self, env: GraspEnv, rows: slice) -> None:
        """Publish what an environment's step wrote."""
        for name in ("observation", "final_observation", "reward", "reward_terms", "terminated", "truncated"):
            getattr(self.out, name)[rows] = getattr(env.o, name)
        if env.mode != "train":
            copy_state(env.s, self.state, rows)


class _Worker:
    """Environments `rows` of a pool, in a process of their own."""

    def __init__(self, conn: Connection, spec: PoolSpec, w: int, workers: int, memory: str) -> None:
        self.conn, self.w, self.rows = conn, w, slice(w, None, workers)
        indices = list(range(len(spec.labels)))[self.rows]
        self.env = GraspEnv([spec.labels[i] for i in indices], spec.hand, spec.objects, spec.config, indices)
        sizes = (len(spec.labels), self.env.observation_size, len(self.env.reward_terms), workers)
        self.shared = _Shared(*sizes, name=memory)
        self._memory: SharedMemory | None = None
        self._trajectories: Trajectories | None = None

    def step(self) -> None:
        self.env.step(self.shared.actions[self.rows])
        self.shared.write(self.env, self.rows)

    def reset(self, epoch: int, mode: Mode) -> None:
        self.env.reset(epoch, mode)
        self.shared.write(self.env, self.rows)

    def remove_table(self) -> None:
        self.env.remove_table()

    def collect(self, actor: Actor, epoch: int, layout: Layout, memory: str) -> None:
        if self._memory is None or self._memory.name != memory:
            self._memory, arrays = _block(layout, memory)
            self._trajectories = Trajectories(**arrays).part(self.rows)
        assert self._trajectories is not None
        with suppress(_Stopped):
            collect(self.env, actor, epoch, self.env.indices, self._trajectories, self._advance)

    def _advance(self, steps: int) -> None:
        self.shared.counts[self.w] += steps
        if self.shared.stop[0]:
            raise _Stopped

    def info(self) -> tuple[float, list[str]]:
        events, self.env.events = self.env.events, []
        return self.env.step_seconds, events

    def serve(self) -> None:
        """Answer commands until told to stop: a method's name and its arguments, or one byte for a step."""
        while True:
            try:
                command = self.conn.recv_bytes()
            except EOFError:
                return
            if command == _STEP:
                self.step()
                answer = None
            elif command == _QUIT:
                return
            else:
                name, *arguments = pickle.loads(command)
                answer = getattr(self, name)(*arguments)
            self.conn.send_bytes(b"k")
            if answer is not None:
                self.conn.send(answer)


def _work(conn: Connection, spec: PoolSpec, w: int, workers: int, memory: str) -> None:
    """A worker's process."""
    # Ctrl-C belongs to the main process, which stops the workers in its own time.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        worker = _Worker(conn, spec, w, workers, memory)
        conn.send_bytes(b"k")
        worker.serve()
        worker.env.close()
    except Exception:
        with suppress(OSError):
            conn.send_bytes(b"e" + traceback.format_exc().encode())


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Workers inherit one BLAS thread each: they already share the cores."""
    before = {key: os.environ.get(key) for key in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                del os.environ[key]
            else:
                os.environ[key] = value


class ProcessPool:
    """See `Pool`."""

    action_size = N_DOF

    def __init__(self, spec: PoolSpec, workers: int) -> None:
        self.labels = spec.labels
        self.num_envs = len(spec.labels)
        self.observation_size = FeatureLayer(spec.config.env.features, spec.config.env.goal_space).size
        self.reward_terms = Reward(spec.config.env.reward).names
        workers = max(1, min(workers, self.num_envs))
        self._shared = _Shared(self.num_envs, self.observation_size, len(self.reward_terms), workers)
        self.state = self._shared.state
        self._connections: list[Connection] = []
        self._processes: list[multiprocessing.process.BaseProcess] = []
        self._events: list[str] = []
        self._start = (time.perf_counter(), 0.0)
        context = multiprocessing.get_context("spawn")
        self._collected: SharedMemory | None = None
        try:
            with _single_threaded():
                for w in range(workers):
                    ours, theirs = context.Pipe()
                    process = context.Process(
                        target=_work, args=(theirs, spec, w, workers, self._shared.memory.name), daemon=True,
                        name=f"dgrasp-worker-{w}",
                    )  # fmt: skip
                    process.start()
                    theirs.close()
                    self._connections.append(ours)
                    self._processes.append(process)
            for w in range(workers):
                self._answer(w)
        except BaseException:
            self.close()
            raise

    def collect(self, actor: Actor, epoch: int, steps: int, advance: Callable[[int], None]) -> Trajectories:
        layout = Trajectories.layout(
            steps, self.num_envs, self.observation_size, self.action_size, len(self.reward_terms)
        )
        if self._collected is None or self._layout != layout:
            self._free(self._collected)
            self._layout = layout
            self._collected, arrays = _block(layout)
            self._trajectories = Trajectories(**arrays)
        self._start = (time.perf_counter(), self._physics_seconds())
        self._shared.counts[:], self._shared.stop[0] = 0, False
        self._send(pickle.dumps(("collect", actor, epoch, layout, self._collected.name)))
        waiting, told = set(range(len(self._connections))), 0
        try:
            while waiting:
                ready = wait([self._connections[w] for w in waiting], timeout=_POLL_S)
                for w in [w for w in waiting if self._connections[w] in ready]:
                    waiting.discard(w)
                    self._answer(w)
                done = int(self._shared.counts.sum())
                advance(done - told)
                told = done
        except BaseException:
            # The workers end at their next control step, and are then ready for other commands.
            self._shared.stop[0] = True
            for w in waiting:
                with suppress(PoolError):
                    self._answer(w)
            raise
        return self._trajectories

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        self._start = (time.perf_counter(), self._physics_seconds())
        self._command(pickle.dumps(("reset", epoch, mode)))
        return self._shared.out.observation

    def step(self, actions: Array) -> Step:
        self._shared.actions[:] = actions
        self._command(_STEP)
        o = self._shared.out
        return Step(o.observation, o.reward, o.terminated, o.truncated, o.final_observation, o.reward_terms)

    def remove_table(self) -> None:
        self._command(pickle.dumps(("remove_table",)))

    def timing(self) -> dict[str, float]:
        physics = self._physics_seconds() - self._start[1]
        wall = time.perf_counter() - self._start[0]
        workers = len(self._connections)
        return {
            "physics_share": physics / max(wall * workers, 1e-9),
            "physics_s": physics,
            "wall_s": wall,
            "workers": float(workers),
        }

    def drain_events(self) -> list[str]:
        self._physics_seconds()
        events, self._events = self._events, []
        return events

    def close(self) -> None:
        for connection in self._connections:
            with suppress(OSError):
                connection.send_bytes(_QUIT)
        for process in self._processes:
            process.join(timeout=5)
            if process.is_alive():
                process.kill()
                process.join()
        for connection in self._connections:
            connection.close()
        self._connections, self._processes = [], []
        self._free(self._shared.memory)
        self._free(self._collected)

    @staticmethod
    def _free(memory: SharedMemory | None) -> None:
        # Arrays still refer to the block; unlinking frees it once they are gone.
        if memory is not None:
            with suppress(FileNotFoundError):
                memory.unlink()

    def _command(self, command: bytes) -> None:
        self._send(command)
        for w in range(len(self._connections)):
            self._answer(w)

    def _send(self, command: bytes) -> None:
        for w, connection in enumerate(self._connections):
            try:
                connection.send_bytes(command)
            except OSError:
                raise self._dead(w) from None

    def _answer(self, w: int) -> None:
        try:
            answer = self._connections[w].recv_bytes()
        except (EOFError, OSError):
            raise self._dead(w) from None
        if answer[:1] == b"e":
            raise PoolError(f"worker {w} failed:\n{answer[1:].decode(errors='replace')}")

    def _dead(self, w: int) -> PoolError:
        process = self._processes[w]
        process.join(timeout=1)
        return PoolError(f"worker {w} died (exit code {process.exitcode}); is there enough memory for its worlds?")

    def _physics_seconds(self) -> float:
        total = 0.0
        for w, connection in enumerate(self._connections):
            connection.send_bytes(pickle.dumps(("info",)))
            self._answer(w)
            seconds, events = connection.recv()
            total += seconds
            self._events += events
        return total
