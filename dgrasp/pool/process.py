"""Environments in worker processes, many to a worker, over shared memory.

Per step, one byte goes to each worker and one comes back; actions, observations and states lie in shared
memory. Environment i belongs to worker i modulo the number of workers, which spreads costly objects evenly.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from dgrasp.env.features import FeatureLayer
from dgrasp.env.grasp_env import GraspEnv, Mode, StepArrays
from dgrasp.env.rewards import Reward
from dgrasp.env.state import STATE_SIZE, copy_state, state_views
from dgrasp.errors import DGraspError
from dgrasp.hand.skeleton import N_DOF
from dgrasp.pool.base import PoolSpec
from dgrasp.rl.vec_env import Step
from dgrasp.types import Array, SceneState

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class PoolError(DGraspError):
    """A worker failed; the message holds its traceback."""


class _Shared:
    """The arrays of all N environments in one block of shared memory."""

    def __init__(self, n: int, observation_size: int, n_terms: int, name: str | None = None) -> None:
        shapes: list[tuple[tuple[int, ...], type]] = [
            ((n * STATE_SIZE,), np.float64),
            ((n, N_DOF), np.float32),
            ((n, observation_size), np.float32),
            ((n, observation_size), np.float32),
            ((n,), np.float32),
            ((n, n_terms), np.float32),
            ((n,), np.bool_),
            ((n,), np.bool_),
        ]
        sizes = [int(np.prod(shape)) * np.dtype(kind).itemsize for shape, kind in shapes]
        self.memory = SharedMemory(name=name) if name else SharedMemory(create=True, size=sum(sizes))
        arrays, offset = [], 0
        for (shape, kind), size in zip(shapes, sizes, strict=True):
            arrays.append(np.ndarray(shape, kind, buffer=self.memory.buf, offset=offset))
            offset += size
        self.state: SceneState = state_views(n, arrays[0])
        self.actions: Array = arrays[1]
        self.out = StepArrays(*arrays[2:])

    def write(self, env: GraspEnv, rows: slice) -> None:
        """Publish what an environment's step wrote."""
        for name in ("observation", "final_observation", "reward", "reward_terms", "terminated", "truncated"):
            getattr(self.out, name)[rows] = getattr(env.o, name)
        if env.mode != "train":
            copy_state(env.s, self.state, rows)


def _work(conn: Connection, spec: PoolSpec, rows: slice, memory: str, layout: tuple[int, int]) -> None:
    """A worker: builds its environments, then answers one-byte commands until told to stop."""
    # Ctrl-C belongs to the main process, which stops the workers in its own time.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        indices = list(range(len(spec.labels)))[rows]
        env = GraspEnv([spec.labels[i] for i in indices], spec.hand, spec.objects, spec.config, indices)
        shared = _Shared(len(spec.labels), *layout, name=memory)
        conn.send_bytes(b"k")
        while True:
            try:
                command = conn.recv_bytes()
            except EOFError:
                break
            if command == b"s":
                env.step(shared.actions[rows])
                shared.write(env, rows)
                conn.send_bytes(b"k")
            elif command == b"t":
                env.remove_table()
                conn.send_bytes(b"k")
            elif command == b"i":
                events, env.events = env.events, []
                conn.send_bytes(b"k")
                conn.send((env.step_seconds, events))
            elif command == b"q":
                break
            else:
                epoch, mode = command[1:].decode().split(",")
                env.reset(int(epoch), mode)  # type: ignore[arg-type]
                shared.write(env, rows)
                conn.send_bytes(b"k")
        env.close()
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
        layout = (self.observation_size, len(self.reward_terms))
        self._shared = _Shared(self.num_envs, *layout)
        self.state = self._shared.state
        self._connections: list[Connection] = []
        self._processes: list[multiprocessing.process.BaseProcess] = []
        self._events: list[str] = []
        self._start = (time.perf_counter(), 0.0)
        context = multiprocessing.get_context("spawn")
        workers = max(1, min(workers, self.num_envs))
        try:
            with _single_threaded():
                for w in range(workers):
                    ours, theirs = context.Pipe()
                    rows = slice(w, None, workers)
                    process = context.Process(
                        target=_work, args=(theirs, spec, rows, self._shared.memory.name, layout), daemon=True,
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

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        self._start = (time.perf_counter(), self._physics_seconds())
        self._command(f"r{epoch},{mode}".encode())
        return self._shared.out.observation

    def step(self, actions: Array) -> Step:
        self._shared.actions[:] = actions
        self._command(b"s")
        o = self._shared.out
        return Step(o.observation, o.reward, o.terminated, o.truncated, o.final_observation, o.reward_terms)

    def remove_table(self) -> None:
        self._command(b"t")

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
                connection.send_bytes(b"q")
        for process in self._processes:
            process.join(timeout=5)
            if process.is_alive():
                process.kill()
                process.join()
        for connection in self._connections:
            connection.close()
        self._connections, self._processes = [], []
        if self._shared.memory.buf is not None:
            # The arrays still refer to the block; unlinking frees it once they are gone.
            with suppress(FileNotFoundError):
                self._shared.memory.unlink()

    def _command(self, command: bytes) -> None:
        for w, connection in enumerate(self._connections):
            try:
                connection.send_bytes(command)
            except OSError:
                raise self._dead(w) from None
        for w in range(len(self._connections)):
            self._answer(w)

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
            connection.send_bytes(b"i")
            self._answer(w)
            seconds, events = connection.recv()
            total += seconds
            self._events += events
        return total
