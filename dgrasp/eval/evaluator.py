"""Run a method on every label of a pool and record the episodes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.methods.method import Method
from dgrasp.pool import Pool, PoolSpec, WorkerLost, make_pool
from dgrasp.types import Array, EpisodeRecord
from raisim_like.registry import in_parts
from raisim_like.rotations import transform

Progress = Callable[[int, int], None]
"""Called with (steps done, total steps)."""

UNSTABLE = "unstable simulation"


class Recorder:
    """Arrays [T, N, ...] of an evaluation; `records` cuts them into episodes."""

    def __init__(self, pool: Pool, steps: int) -> None:
        n, state = pool.num_envs, pool.state
        self.pool, self.steps, self.t = pool, steps, 0
        self.gc = np.zeros((steps, *state.gc.shape))
        self.T_WH = np.zeros((steps, n, 4, 4))
        self.T_WO = np.zeros((steps, n, 4, 4))
        self.T_WG = np.zeros((steps, n, 4, 4))
        self.joints_W = np.zeros((steps, *state.joints_W.shape))
        self.contacts = np.zeros((steps, *state.contacts.shape))
        self.contact_impulse = np.zeros((steps, *state.contacts.shape))
        self.table_contact = np.zeros((steps, n), bool)
        self.reward = np.zeros((steps, n))
        self.length: Array = np.full(n, steps)

    def write(self, reward: Array, terminated: Array) -> None:
        t, s = self.t, self.pool.state
        self.gc[t], self.joints_W[t] = s.gc, s.joints_W
        self.T_WH[t] = transform(s.R_WH, s.joints_W[:, 0])
        self.T_WO[t] = transform(s.R_WO, s.object_pos_W)
        self.T_WG[t] = transform(s.R_WG, s.target_pos_W)
        self.contacts[t], self.contact_impulse[t] = s.contacts, s.contact_impulse
        self.table_contact[t], self.reward[t] = s.table_contact > 0, reward
        # After the step that broke an episode, the pool shows a restarted world; that step is left out.
        self.length = np.where(terminated & (self.length == self.steps), t, self.length)
        self.t += 1

    def records(self, window_start: int, dt: float, with_target: bool = False) -> list[EpisodeRecord]:
        """One record per label; with_target: include the object's target poses, for episodes that move the object."""
        made = []
        for i, label in enumerate(self.pool.labels):
            cut = slice(0, int(self.length[i]))
            made.append(
                EpisodeRecord(
                    label=label,
                    gc=self.gc[cut, i],
                    T_WH=self.T_WH[cut, i],
                    joints_W=self.joints_W[cut, i],
                    T_WO=self.T_WO[cut, i],
                    contacts=self.contacts[cut, i],
                    contact_impulse=self.contact_impulse[cut, i],
                    table_contact=self.table_contact[cut, i],
                    reward=self.reward[cut, i],
                    window_start=window_start,
                    dt=dt,
                    terminated="" if self.length[i] == self.steps else UNSTABLE,
                    T_WG=self.T_WG[cut, i] if with_target else None,
                )
            )
        return made


ATTEMPTS = 3
"""Number of times that an evaluation is tried if a worker is lost."""

Cost = dict[str, float]
"""control_steps, wall_s, physics_share."""


def evaluate_labels(
    spec: PoolSpec, method: Method, progress: Progress | None = None
) -> tuple[list[EpisodeRecord], Cost, list[str]]:
    """Run `evaluate` on all labels of `spec`; returns records, cost and the pools' events.

    The window is that of the spec's config. Pools are made for `parts_of` the labels at a time, to limit memory.
    The records are bitwise the same as in one pool.
    """
    config, parts, total = spec.config, parts_of(spec), evaluation_steps(spec, method)
    records: list[EpisodeRecord] = []
    costs: list[Cost] = []
    events: list[str] = []
    for k, part in enumerate(parts):
        pool = make_pool(replace(spec, labels=spec.labels[part]))
        try:
            made, cost = evaluate(pool, method, config, shifted(progress, k * total // len(parts), total))
            events += pool.drain_events()
        finally:
            pool.close()
        records += made
        costs.append(cost)
    return records, summed(costs), events


def parts_of(spec: PoolSpec) -> list[slice]:
    """Slices of the labels: a part is simulated at once, the parts one after another (`registry.in_parts`)."""
    return in_parts(len(spec.labels), spec.config.engine)


def evaluation_steps(spec: PoolSpec, method: Method) -> int:
    """Total number of steps that `evaluate_labels` reports to its progress callback."""
    episode = grasp_steps(method, spec.config) + spec.config.window_steps
    return len(parts_of(spec)) * episode


def shifted(progress: Progress | None, done: int, total: int) -> Progress | None:
    """A callback for one part that reports progress of the whole to `progress`."""
    return None if progress is None else lambda step, _: progress(done + step, total)


def summed(costs: Sequence[Cost]) -> Cost:
    """The total cost of several evaluations; physics_share is weighted by wall time."""
    wall = sum(cost["wall_s"] for cost in costs)
    physics = sum(cost["wall_s"] * cost["physics_share"] for cost in costs)
    return {"control_steps": sum(cost["control_steps"] for cost in costs), "wall_s": wall,
            "physics_share": physics / max(wall, 1e-9)}


def evaluate(
    pool: Pool, method: Method, config: Config, progress: Progress | None = None
) -> tuple[list[EpisodeRecord], Cost]:
    """Records of one deterministic episode per label, and the cost (control_steps, wall_s, physics_share).

    A policy grasps for `env.grasp_steps`; then the table is taken away and the window of `eval.window_s` seconds begins
    (supplement B.3). For a baseline that starts in the label's pose, the episode begins with the window.
    """
    grasp = grasp_steps(method, config)
    steps = grasp + config.window_steps
    # An episode without a grasping phase starts without a table.
    begin = pool.remove_table if grasp else None
    recorder, cost = run_episodes(pool, method, steps, grasp, begin, progress)
    return recorder.records(grasp, config.control_period), cost


def grasp_steps(method: Method, config: Config) -> int:
    """Control steps before the test begins; 0 for a method that starts in the label's pose."""
    return 0 if method.mode == "label" else config.env.grasp_steps


def run_episodes(
    pool: Pool, method: Method, steps: int, grasp: int, begin: Callable[[], None] | None,
    progress: Progress | None = None,
) -> tuple[Recorder, Cost]:
    """Run one deterministic episode per label, with `begin` called after `grasp` control steps.

    Starts over if a worker is lost, at most `ATTEMPTS` times in all; then raises `WorkerLost`.
    """
    started = time.perf_counter()
    for attempt in range(1, ATTEMPTS + 1):
        try:
            recorder = _run(pool, method, steps, grasp, begin, progress)
            break
        except WorkerLost:
            if attempt == ATTEMPTS:
                raise
    cost = {
        "control_steps": float(steps * pool.num_envs),
        "wall_s": time.perf_counter() - started,
        "physics_share": pool.timing()["physics_share"],
    }
    return recorder, cost


def _run(
    pool: Pool, method: Method, steps: int, grasp: int, begin: Callable[[], None] | None, progress: Progress | None
) -> Recorder:
    recorder = Recorder(pool, steps)
    observation = pool.reset(0, method.mode)
    for t in range(steps):
        if begin is not None and t == grasp:
            begin()
        result = pool.step(method.act(observation))
        observation = result.observation
        recorder.write(result.reward, result.terminated)
        if progress is not None:
            progress(t + 1, steps)
    return recorder
