"""PyBullet as an engine: several worlds advanced together."""

from __future__ import annotations

import time
from collections.abc import Sequence

from raisim_like.batch import Preset
from raisim_like.engines.bullet.pd import HOLD, ControlBatch, ImplicitPd, blocks
from raisim_like.engines.bullet.quiet_pybullet import pybullet as p
from raisim_like.engines.bullet.world import BulletWorld
from raisim_like.engines.protocol import EngineWorld, engine_steps

CONTROL_STEP = 13
"""Most substeps for which the controller keeps its mass matrices; outdated ones make it unstable."""
CHUNK = 8
"""Worlds that are stepped together, block by block: enough to batch their algebra, few enough for the cache."""


class BulletEngine:
    """PyBullet. Its worlds are independent clients; one process may hold many."""

    name = "pybullet"

    def make_world(self, timestep: float, preset: Preset) -> EngineWorld:
        return BulletWorld(timestep, preset)

    def integrate(self, worlds: Sequence[EngineWorld], substeps: int, threads: int = 1) -> None:
        mine = [w for w in worlds if isinstance(w, BulletWorld)]
        pushed = [w for w in mine if w.begin_pending()] if substeps else []
        if pushed:
            integrate_worlds(pushed, 1)
            for world in pushed:
                world.end_pending()
            _integrate(pushed, substeps - 1)
            mine = [w for w in mine if w not in pushed]
        _integrate(mine, substeps)


def _integrate(worlds: Sequence[BulletWorld], substeps: int) -> None:
    for done in range(0, substeps, CONTROL_STEP):
        integrate_worlds(worlds, min(CONTROL_STEP, substeps - done))


def integrate_worlds(worlds: Sequence[BulletWorld], substeps: int) -> None:
    """Advance worlds together: the linear algebra of their controllers is batched, the steps are not."""
    for kind in dict.fromkeys((world.timestep, world.preset) for world in worlds):
        alike = [world for world in worlds if (world.timestep, world.preset) == kind]
        for first in range(0, len(alike), CHUNK):
            _integrate_chunk(alike[first : first + CHUNK], substeps)


def _integrate_chunk(worlds: Sequence[BulletWorld], substeps: int) -> None:
    timestep, preset = worlds[0].timestep, worlds[0].preset
    total, length = engine_steps(substeps, timestep, preset)
    groups: dict[int, list[ImplicitPd]] = {}
    for world in worlds:
        for system in world.systems.values():
            system.set_timestep(length)
            groups.setdefault(id(system.model), []).append(system)
    batches = [ControlBatch(group, length / timestep) for group in groups.values()]
    clock = time.perf_counter
    for steps in blocks(total, length, HOLD[preset]):
        for batch in batches:
            batch.push(steps)
        for world in worlds:
            # Send, step and read each world in turn: its memory is in the cache.
            for system in world.systems.values():
                system.apply()
            world.set_block(steps, length)
            world.use_threshold()
            start = clock()
            p.stepSimulation(physicsClientId=world.client)
            world.step_seconds += clock() - start
            for system in world.systems.values():
                system.observe()
        for batch in batches:
            batch.pull(steps)
    for batch in batches:
        batch.store()
