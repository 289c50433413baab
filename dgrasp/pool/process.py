"""Environments in worker processes, many per worker, with shared memory.

To collect an epoch, the pool sends the actor to each worker once. Each worker then makes all its control steps without
waiting for the others. When the pool is stepped from outside, one byte goes to each worker per step and one comes back.
Observations, actions and states lie in shared memory.

At first, environment i belongs to worker i modulo the number of workers. After epochs 1, 10 and 100 the pool compares
the measured costs and may give each worker a contiguous stretch of the set, all of nearly equal cost
(`dgrasp.pool.balance`).

A worker that dies or hangs is replaced by a new one with the same environments. Its experience of the epoch is lost;
that of the other workers is kept.
"""

from __future__ import annotations

import multiprocessing
import pickle
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from dgrasp.control.motion import Fingers
from dgrasp.env.grasp_env import Mode
from dgrasp.pool.balance import BALANCE_AFTER, costs, worthwhile
from dgrasp.pool.base import LOSSES_IN_A_ROW, POLL_S, PoolError, PoolSpec, SizedPool, WorkerLost
from dgrasp.pool.starting import check_main, lost_at_start, single_threaded
from dgrasp.pool.worker import FAILED, QUIT, STEP, Shared, Told, shared_arrays, work
from dgrasp.rl.collect import Actor, Trajectories
from dgrasp.rl.step import Layout, Step
from dgrasp.types import Array


@dataclass
class _Member:
    """A worker process, the main process's end of its pipe, and the losses since its last success."""

    process: BaseProcess
    connection: Connection
    losses: int = 0


class ProcessPool(SizedPool):
    """See `Pool`."""

    def __init__(self, spec: PoolSpec, workers: int) -> None:
        check_main()
        super().__init__(spec)
        self._spec, self._deadline_s = spec, spec.config.pool.hang_s
        self._workers = max(1, min(workers, self.num_envs))
        sizes = (self.num_envs, self.hand, self.observation_size, self.action_size, len(self.reward_terms))
        self._shared = Shared(*sizes, self._workers)
        self.state = self._shared.state
        self._collected: SharedMemory | None = None
        self._layout: Layout = {}
        self._members: list[_Member] = []
        self._lost = 0
        self._start = time.perf_counter()
        self._rows = [slice(w, self.num_envs, self._workers) for w in range(self._workers)]
        self._spent = np.zeros((2, self.num_envs))
        """Seconds inside the engine and control steps made, by environment."""
        self._told: list[Array] = [np.zeros((2, 1))] * self._workers
        """The same counts as last reported by the present workers, one array per worker."""
        self._physics = 0.0
        self._collections = 0
        try:
            for w in range(self._workers):
                self._members.append(self._new_member(w))
            for w in range(self._workers):
                self._send_spec(w)
            for w in range(self._workers):
                self._receive(w, None)
        except WorkerLost as lost:
            self.close()
            raise lost_at_start(lost) from None
        except BaseException:
            self.close()
            raise

    def _new_member(self, w: int) -> _Member:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        arguments = (theirs, w, self._workers, self._rows[w], self._shared.memory.name)
        process = context.Process(target=work, args=arguments, daemon=True, name=f"dgrasp-worker-{w}")
        with single_threaded():
            process.start()
        theirs.close()
        return _Member(process, ours)

    def _send_spec(self, w: int) -> None:
        # Not an argument of the process: passing one blocks forever if the process ends before it reads it.
        with suppress(OSError):
            self._members[w].connection.send(self._spec)

    # What a learner needs ----------------------------------------------------------------------

    def collect(self, actor: Actor, epoch: int, steps: int, advance: Callable[[int], None]) -> Trajectories:
        self._begin()
        if self._collections in BALANCE_AFTER:
            self._balance()
        sizes = (steps, self.num_envs, self.observation_size, self.action_size, len(self.reward_terms))
        layout = Trajectories.layout(*sizes)
        if self._layout != layout:
            _free(self._collected)
            self._layout = layout
            self._collected, arrays = shared_arrays(layout)
            self._trajectories = Trajectories(**arrays)
        assert self._collected is not None
        self._trajectories.valid[:] = False
        self._shared.counts[:], self._shared.stop[0] = 0, False
        command = pickle.dumps(("collect", actor, epoch, layout, self._collected.name))
        waiting, lost = set(range(self._workers)), []
        for w in range(self._workers):
            # A worker that has died is detected below by the closed end of its pipe.
            with suppress(OSError):
                self._members[w].connection.send_bytes(command)
        try:
            for w in self._arrivals(waiting, advance):
                try:
                    self._receive(w, 0.0)
                    self._members[w].losses = 0
                except WorkerLost as loss:
                    self._events.append(f"{loss}; the experience of its environments in this epoch is dropped")
                    lost.append(w)
        except BaseException:
            # The workers stop after their present control step and are then ready for other commands.
            self._shared.stop[0] = True
            for w in waiting:
                with suppress(WorkerLost, PoolError):
                    self._receive(w, self._deadline_s)
            raise
        for w in lost:
            self._replace(w)
        self._collections += 1
        return self._trajectories

    def _balance(self) -> None:
        """Divide the environments again if the measured costs make it worthwhile."""
        rows = worthwhile(costs(*self._spent), self._rows)
        if rows is None:
            return
        self._rows = rows
        for w in range(self._workers):
            self._told[w] = np.zeros((2, 1))
            with suppress(OSError):
                self._members[w].connection.send_bytes(pickle.dumps(("assign", rows[w])))
        for w in range(self._workers):
            try:
                self._receive(w, None)
            except WorkerLost:
                self._replace(w)

    def _arrivals(self, waiting: set[int], advance: Callable[[int], None]) -> Iterator[int]:
        """Yield each worker when it answers, dies or misses the deadline, and remove it from `waiting`."""
        counts, told = self._shared.counts, 0
        last, moved = counts.copy(), [time.monotonic()] * self._workers
        while waiting:
            ready = wait([self._members[w].connection for w in waiting], timeout=POLL_S)
            now = time.monotonic()
            for w in sorted(waiting):
                if counts[w] != last[w]:
                    last[w], moved[w] = counts[w], now
                if self._members[w].connection in ready or now - moved[w] > self._deadline_s:
                    waiting.discard(w)
                    yield w
            done = int(counts.sum())
            advance(done - told)
            told = done

    def timing(self) -> dict[str, float]:
        physics = self._listen() - self._physics
        wall = time.perf_counter() - self._start
        return {
            "physics_share": physics / max(wall * self._workers, 1e-9),
            "physics_s": physics,
            "wall_s": wall,
            "workers": float(self._workers),
            "lost_workers": float(self._lost),
        }

    def drain_events(self) -> list[str]:
        self._listen()
        return super().drain_events()

    # Steps and phases of a test ----------------------------------------------------------------

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        self._begin()
        self._command(pickle.dumps(("reset", epoch, mode)))
        return self._shared.out.observation

    def step(self, actions: Array) -> Step:
        self._shared.actions[:] = actions
        self._command(STEP)
        return self._shared.out

    def remove_table(self) -> None:
        self._command(pickle.dumps(("remove_table",)))

    def begin_motion(self, path: Array, fingers: Fingers = "policy") -> None:
        self._command(pickle.dumps(("begin_motion", path, fingers)))

    def close(self) -> None:
        for member in self._members:
            with suppress(OSError):
                member.connection.send_bytes(QUIT)
        for member in self._members:
            _end(member, patience_s=5.0)
        self._members = []
        _free(self._shared.memory)
        _free(self._collected)

    # Talking to workers ------------------------------------------------------------------------

    def _begin(self) -> None:
        self._start, self._physics = time.perf_counter(), self._listen()

    def _command(self, command: bytes) -> None:
        """Send a command to all workers and wait for their answers.

        Lost workers are replaced; `WorkerLost` is then raised, because the new workers have not executed the command.
        """
        losses = []
        for w in range(self._workers):
            with suppress(OSError):
                self._members[w].connection.send_bytes(command)
        for w in range(self._workers):
            try:
                self._receive(w, self._deadline_s)
                self._members[w].losses = 0
            except WorkerLost as loss:
                losses.append(str(loss))
                self._replace(w)
        if losses:
            raise WorkerLost("; ".join(losses))

    def _receive(self, w: int, patience_s: float | None) -> None:
        """Wait for a worker's answer; a `patience_s` of None waits without limit.

        `WorkerLost` if the worker died or does not answer in time, `PoolError` with its traceback if it failed.
        """
        member = self._members[w]
        try:
            if not member.connection.poll(patience_s):
                member.process.kill()
                raise WorkerLost(f"worker {w} hung: no control step in {self._deadline_s:g} s (pool.hang_s)")
            answer = member.connection.recv_bytes()
        except (EOFError, OSError):
            member.process.join(timeout=1)
            code = member.process.exitcode
            raise WorkerLost(f"worker {w} died (exit code {code})", code) from None
        if answer[:1] == FAILED:
            raise PoolError(f"worker {w} failed:\n{answer[1:].decode(errors='replace')}")

    def _replace(self, w: int) -> None:
        """Replace a worker by a new one with the same environments; `PoolError` after too many losses in a row."""
        losses = self._members[w].losses + 1
        _end(self._members[w], patience_s=0.0)
        if losses >= LOSSES_IN_A_ROW:
            raise PoolError(f"worker {w} was lost {losses} times in a row; is there enough memory for its worlds?")
        self._members[w] = self._new_member(w)
        self._members[w].losses = losses
        self._send_spec(w)
        # A new worker counts from zero.
        self._told[w] = np.zeros((2, 1))
        self._lost += 1
        try:
            self._receive(w, None)
        except WorkerLost:
            self._replace(w)

    def _listen(self) -> float:
        """Collect costs, events and incidents from the workers; return the seconds inside the engine so far."""
        command = pickle.dumps(("tell",))
        for w in range(self._workers):
            try:
                connection = self._members[w].connection
                connection.send_bytes(command)
                self._receive(w, self._deadline_s)
                told: Told = connection.recv()
            except (WorkerLost, EOFError, OSError) as lost:
                self._events.append(f"{lost}, between two epochs")
                self._replace(w)
                continue
            now = np.stack([told.seconds, told.steps])
            self._spent[:, self._rows[w]] += now - self._told[w]
            self._told[w] = now
            self._events += told.events
            self._incidents += told.incidents
        return float(self._spent[0].sum())


def _end(member: _Member, patience_s: float) -> None:
    member.process.join(timeout=patience_s)
    if member.process.is_alive():
        member.process.kill()
        member.process.join()
    member.connection.close()


def _free(memory: SharedMemory | None) -> None:
    # Arrays still refer to the block; unlinking frees it once they are gone.
    if memory is not None:
        with suppress(FileNotFoundError):
            memory.unlink()
