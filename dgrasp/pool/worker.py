"""A worker process of the pool, and the shared memory between it and the main process."""

from __future__ import annotations

import os
import pickle
import signal
import traceback
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from typing import NamedTuple

import numpy as np

from dgrasp.control.motion import Fingers
from dgrasp.env.grasp_env import GraspEnv, Mode
from dgrasp.hand.layout import HandLayout
from dgrasp.pool.base import PoolError, PoolSpec, make_env
from dgrasp.rl.collect import Actor, Incident, Trajectories, collect
from dgrasp.rl.step import Layout, Step
from dgrasp.scene.state import copy_state, state_size, state_views
from dgrasp.types import Array, SceneState

OK, FAILED = b"k", b"e"
"""First byte of an answer; after FAILED comes the traceback."""
STEP, QUIT = b"s", b"q"


class _Stopped(Exception):
    """The main process has asked to end the collection."""


def shared_arrays(layout: Layout, name: str | None = None) -> tuple[SharedMemory, dict[str, Array]]:
    """Named arrays in one block of shared memory: a new block, or the existing block `name`."""
    sizes = {key: int(np.prod(shape)) * np.dtype(kind).itemsize for key, (shape, kind) in layout.items()}
    memory = SharedMemory(name=name) if name else _new_memory(sum(sizes.values()))
    arrays: dict[str, Array] = {}
    offset = 0
    for key, (shape, kind) in layout.items():
        arrays[key] = np.ndarray(shape, kind, buffer=memory.buf, offset=offset)
        offset += sizes[key]
    return memory, arrays


def _new_memory(size: int) -> SharedMemory:
    """Shared memory of `size` bytes, all zero and all allocated; `PoolError` if there is not enough."""
    memory = None
    try:
        memory = SharedMemory(create=True, size=size)
        file = f"/dev/shm/{memory.name}"
        if hasattr(os, "posix_fallocate") and os.path.exists(file):
            # Linux allocates a page when it is first written to, and kills the process if there is none.
            handle = os.open(file, os.O_RDWR)
            try:
                os.posix_fallocate(handle, 0, size)
            finally:
                os.close(handle)
        return memory
    except OSError as error:
        if memory is not None:
            memory.close()
            memory.unlink()
        raise PoolError(f"{size / 2**20:.1f} MiB of shared memory for the workers cannot be allocated "
                        f"({error.strerror or error}); give this machine or container more (its /dev/shm), set "
                        "pool.kind=serial, or take fewer labels: labels.objects, labels.limit_per_object") from None


class Shared:
    """The shared arrays of all N environments for steps from outside, and the counts and stop flag of a collection."""

    def __init__(
        self, n: int, hand: HandLayout, observation_size: int, action_size: int, n_terms: int, workers: int,
        name: str | None = None,
    ) -> None:
        # The widest types come first, so that every array is aligned.
        layout: Layout = {
            "state": ((n * state_size(hand),), np.float64),
            "counts": ((workers,), np.int64),
            "actions": ((n, action_size), np.float32),
            **Step.layout(n, observation_size, n_terms),
            "stop": ((1,), np.bool_),
        }
        self.memory, arrays = shared_arrays(layout, name)
        self.state: SceneState = state_views(n, hand, arrays.pop("state"))
        self.actions: Array = arrays.pop("actions")
        self.counts: Array = arrays.pop("counts")
        """Control steps that each worker has made in this collection."""
        self.stop: Array = arrays.pop("stop")
        """Tells the workers to end a collection early."""
        self.out = Step(**arrays)

    def write(self, env: GraspEnv, rows: slice) -> None:
        """Copy the results of a step of `env` into its rows; the states only outside training."""
        self.out.write(rows, env.o)
        if env.mode != "train":
            copy_state(env.s, self.state, rows)


class Told(NamedTuple):
    """A worker's report.

    seconds, steps: (n,) seconds inside the engine and control steps made so far, by environment. events, incidents:
    those since the last report.
    """

    seconds: Array
    steps: Array
    events: list[str]
    incidents: list[Incident]


class Worker:
    """Some environments of a pool. Each public method except `serve` is a command."""

    def __init__(self, conn: Connection, spec: PoolSpec, w: int, workers: int, rows: slice, memory: str) -> None:
        self._conn, self._spec, self._w = conn, spec, w
        self.env = self._make(rows)
        env = self.env
        sizes = (len(spec.labels), spec.hand.layout, env.observation_size, env.action_size, len(env.reward_terms))
        self._shared = Shared(*sizes, workers, name=memory)
        self._memory: SharedMemory | None = None
        self._trajectories: Trajectories | None = None
        self._incidents: list[Incident] = []

    def _make(self, rows: slice) -> GraspEnv:
        self._rows, spec = rows, self._spec
        return make_env(spec, rows)

    def assign(self, rows: slice) -> None:
        """Take over other environments."""
        self.env.close()
        self.env = self._make(rows)
        # Drop the collection's arrays: the present views are of the old rows.
        self._memory = None

    def step(self) -> None:
        self.env.step(self._shared.actions[self._rows])
        self._shared.write(self.env, self._rows)

    def reset(self, epoch: int, mode: Mode) -> None:
        self.env.reset(epoch, mode)
        self._shared.write(self.env, self._rows)

    def remove_table(self) -> None:
        self.env.remove_table()

    def begin_motion(self, path: Array, fingers: Fingers) -> None:
        self.env.begin_motion(path[self._rows], fingers)
        self._shared.write(self.env, self._rows)

    def collect(self, actor: Actor, epoch: int, layout: Layout, memory: str) -> None:
        if self._memory is None or self._memory.name != memory:
            self._memory, arrays = shared_arrays(layout, memory)
            self._trajectories = Trajectories(**arrays).part(self._rows)
        assert self._trajectories is not None
        with suppress(_Stopped):
            self._incidents += collect(self.env, actor, epoch, self.env.indices, self._trajectories, self._advance)

    def _advance(self, steps: int) -> None:
        self._shared.counts[self._w] += steps
        if self._shared.stop[0]:
            raise _Stopped

    def tell(self) -> Told:
        told = Told(self.env.seconds_per_env, self.env.steps_made, self.env.events, self._incidents)
        self.env.events, self._incidents = [], []
        return told

    def serve(self) -> None:
        """Execute and answer commands until told to quit.

        A command is the name of a method and its arguments, or a single byte: STEP or QUIT.
        """
        while True:
            try:
                command = self._conn.recv_bytes()
            except EOFError:
                return
            if command == STEP:
                self.step()
                answer = None
            elif command == QUIT:
                return
            else:
                name, *arguments = pickle.loads(command)
                answer = getattr(self, name)(*arguments)
            self._conn.send_bytes(OK)
            if answer is not None:
                self._conn.send(answer)


def work(conn: Connection, w: int, workers: int, rows: slice, memory: str) -> None:
    """The main function of a worker process: receive the pool's spec, make the environments, report, and serve."""
    # The main process handles Ctrl-C and stops the workers when it is ready.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        worker = Worker(conn, conn.recv(), w, workers, rows, memory)
        conn.send_bytes(OK)
        worker.serve()
        worker.env.close()
    except Exception:
        with suppress(OSError):
            conn.send_bytes(FAILED + traceback.format_exc().encode())
