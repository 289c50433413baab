"""A batch of worlds as a loop over `World` objects: for engines that simulate one world at a time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np

from raisim_like.articulated_system import ArticulatedSystem
from raisim_like.batch import Array, BatchState, Rows, WorldSpec
from raisim_like.rigid_body import RigidBody
from raisim_like.world import World, integrate


class _Row:
    """One world, with the systems and bodies that make up its row of the state."""

    def __init__(self, spec: WorldSpec, engine: str) -> None:
        self.world = World.from_spec(spec, engine)
        self.engine_world = self.world.engine_world
        items = self.world.objects
        self.systems = [item for item in items if isinstance(item, ArticulatedSystem)]
        self.bodies = [item for item in items if isinstance(item, RigidBody)]
        ends = accumulate((system.dof for system in self.systems), initial=0)
        self.parts = [slice(start, stop) for start, stop in pairwise(ends)]
        # Ids, indices and slices that every step needs.
        self.driven = [(system.id, part) for system, part in zip(self.systems, self.parts, strict=True)]
        self.moving = [(k, body.id) for k, body in enumerate(self.bodies) if body.mass > 0]
        self.static = [k for k, body in enumerate(self.bodies) if body.mass == 0]


class LoopBatch:
    """A `WorldBatch` over `World` objects of one engine. See `WorldBatch` for the methods."""

    def __init__(self, engine: str, specs: Sequence[WorldSpec], state: BatchState, threads: int = 1) -> None:
        self.engine, self.specs, self.state, self._threads = engine, specs, state, threads
        self._rows = [_Row(spec, engine) for spec in specs]
        self._retired_seconds = np.zeros(len(specs))

    @property
    def worlds(self) -> list[World]:
        """One `World` per row, for callers that use RaiSim's interface."""
        return [row.world for row in self._rows]

    @property
    def seconds(self) -> Array:
        return self._retired_seconds + [row.engine_world.step_seconds for row in self._rows]

    def close(self) -> None:
        for row in self._rows:
            row.world.close()

    def rebuild(self, rows: Rows) -> None:
        for i in rows:
            # A broken world keeps its NaNs; only a new one is clean.
            self._retired_seconds[i] += self._rows[i].engine_world.step_seconds
            self._rows[i].world.close()
            self._rows[i] = _Row(self.specs[i], self.engine)

    def place(self, rows: Rows, bases: Array, gc: Array, bodies: Array) -> None:
        for k, i in enumerate(rows):
            row = self._rows[i]
            row.engine_world.forget_contacts()
            for body in row.static:
                self._move(i, body, bodies[k, body])
            for system, part, base in zip(row.systems, row.parts, bases[k], strict=True):
                system.set_base_pose(base[:3], base[3:])
                system.set_state(gc[k, part])
            for body, _ in row.moving:
                self._move(i, body, bodies[k, body])
            self._read(i)

    def move(self, rows: Rows, body: int, states: Array) -> None:
        for i, state in zip(rows, states, strict=True):
            self._move(i, body, state)

    def _move(self, i: int, body: int, state: Array) -> None:
        self._rows[i].bodies[body].set_state(state[:3], state[3:7], state[7:10], state[10:])
        # `_read` skips static bodies, so their state is written here.
        self.state.bodies[i, body] = state

    def set_gains(self, rows: Rows, kp: Array, kd: Array, feed_forward: Array) -> None:
        for k, i in enumerate(rows):
            row = self._rows[i]
            for system, part in zip(row.systems, row.parts, strict=True):
                system.set_pd_gains(kp[k, part], kd[k, part])
                system.set_generalized_force(feed_forward[k, part])

    def advance(self, rows: Rows, targets: Array, substeps: int) -> None:
        # The targets go straight to the engine; checking them is up to the caller.
        for i in rows:
            row = self._rows[i]
            for system, part in row.driven:
                row.engine_world.set_pd_target(system, targets[i, part])
        integrate([self._rows[i].world for i in rows], substeps, self._threads)
        for i in rows:
            self._read(i)

    def _read(self, i: int) -> None:
        row, state = self._rows[i], self.state
        for system, part in row.driven:
            row.engine_world.get_joint_state(system, state.gc[i, part], state.gv[i, part])
        for k, body in row.moving:
            row.engine_world.get_body_state(body, state.bodies[i, k])

    def link_impulses(self, rows: Rows, body: int, out: Array) -> None:
        for i in rows:
            row = self._rows[i]
            other = row.bodies[body].id
            for system, part in row.driven:
                row.engine_world.link_impulses(system, other, out[i, part])

    def touching(self, rows: Rows, body: int, other: int, out: Array) -> None:
        for i in rows:
            row = self._rows[i]
            out[i] = row.engine_world.touching(row.bodies[body].id, row.bodies[other].id)

    def broken(self) -> Array:
        return self.state.broken()
