"""`WorldBatch` on MuJoCo Warp: worlds with equal models form a group and are advanced together."""

from __future__ import annotations

import time
from collections.abc import Hashable, Iterator, Sequence

import numpy as np

from raisim_like.batch import Array, BatchState, Rows, WorldSpec
from raisim_like.engines.mujoco_warp.group import Group
from raisim_like.engines.mujoco_warp.parts import model_key


class WarpBatch:
    """See `WorldBatch` for the methods.

    The device computes in single precision: a state that is set keeps its double precision until the row advances. A
    row that breaks is taken out of its group, and stays as it is until it is placed again. `threads` has no effect: the
    device divides the work itself.
    """

    def __init__(self, specs: Sequence[WorldSpec], state: BatchState, threads: int = 1) -> None:
        self.specs, self.state = specs, state
        members: dict[Hashable, list[int]] = {}
        for i, spec in enumerate(specs):
            members.setdefault(model_key(spec), []).append(i)
        self.groups = [Group([specs[i] for i in rows]) for rows in members.values()]
        self._group, self._row = np.zeros((2, len(specs)), int)
        for k, rows in enumerate(members.values()):
            self._group[rows], self._row[rows] = k, range(len(rows))
        self._seconds = np.zeros(len(specs))

    def _parts(self, rows: Rows | Array) -> Iterator[tuple[Group, Array, Array]]:
        """For each group: which entries of `rows` belong to it, and their rows in the group."""
        chosen = np.asarray(rows, dtype=int)
        for k, group in enumerate(self.groups):
            entries = (self._group[chosen] == k).nonzero()[0]
            if entries.size:
                yield group, entries, self._row[chosen[entries]]

    @property
    def seconds(self) -> Array:
        return self._seconds.copy()

    def close(self) -> None:
        self.groups = []

    def place(self, rows: Rows, bases: Array, gc: Array, bodies: Array) -> None:
        for group, entries, mine in self._parts(rows):
            group.place(mine, bases[entries], gc[entries], bodies[entries])
        at = np.asarray(rows, dtype=int)
        self.state.gc[at], self.state.gv[at], self.state.bodies[at] = gc, 0.0, bodies

    def move(self, rows: Rows, body: int, states: Array) -> None:
        for group, entries, mine in self._parts(rows):
            group.move(mine, body, states[entries])
        self.state.bodies[np.asarray(rows, dtype=int), body] = states

    def set_gains(self, rows: Rows, kp: Array, kd: Array, feed_forward: Array) -> None:
        for group, entries, mine in self._parts(rows):
            group.set_gains(mine, kp[entries], kd[entries], feed_forward[entries])

    def advance(self, rows: Rows, targets: Array, substeps: int) -> None:
        broken = self.broken()
        sound = np.array([i for i in rows if not broken[i]], dtype=int)
        for group, entries, mine in self._parts(sound):
            at, start = sound[entries], time.perf_counter()
            group.advance(mine, targets[at], substeps)
            self._seconds[at] += (time.perf_counter() - start) / len(at)
            group.read(mine, self.state, at)
        for group, _, mine in self._parts(sound[self.broken()[sound]]):
            group.park(mine)

    def link_impulses(self, rows: Rows, body: int, out: Array) -> None:
        for group, entries, mine in self._parts(rows):
            out[np.asarray(rows, dtype=int)[entries]] = group.on_links[mine, :, body] * group.spec.timestep

    def touching(self, rows: Rows, body: int, other: int, out: Array) -> None:
        for group, entries, mine in self._parts(rows):
            out[np.asarray(rows, dtype=int)[entries]] = group.between[mine, body, other] > 0.0

    def broken(self) -> Array:
        return self.state.broken()

    def rebuild(self, rows: Rows) -> None:
        for group, _, mine in self._parts(rows):
            group.park(mine)
