"""Runs that pools are compared by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgrasp.env.grasp_env import Mode
from dgrasp.pool.base import Pool
from dgrasp.rl.collect import Actor
from dgrasp.types import Array

STEPS = 6
EPISODE = 24
"""Control steps. The hands touch the boxes from the seventh on."""
SHORT = [f"env.episode_steps={EPISODE}", "env.grasp_steps=20"]


def run(pool: Pool, mode: Mode = "train") -> list[Array]:
    """All results of a pool over a few random steps; in a test, the table is taken away halfway."""
    rng = np.random.default_rng(7)
    said = [pool.reset(3, mode).copy()]
    for t in range(STEPS):
        if mode == "test" and t == STEPS // 2:
            pool.remove_table()
        step = pool.step(rng.normal(size=(pool.num_envs, 51)).astype(np.float32))
        # Only ended episodes have a final observation.
        final = step.final_observation[step.terminated | step.truncated]
        said += [np.array(part) for part in vars(replace(step, final_observation=final)).values()]
        if mode == "test":
            said += [pool.state.gc.copy(), pool.state.joints_W.copy(), pool.state.table_contact.copy()]
    return said


def random_actor(seed: int = 5) -> Actor:
    """A policy of one random layer."""
    rng = np.random.default_rng(0)
    layer = (rng.normal(size=(51, 279)).astype(np.float32) / 50, rng.normal(size=51).astype(np.float32))
    return Actor((layer,), np.full(51, 0.5, np.float32), seed)
