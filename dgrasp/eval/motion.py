"""The experiment of motion synthesis: grasp, leave out unstable grasps, move to targets, measure the final errors."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.data import DataChoice
from dgrasp.errors import ConfigError, DataError
from dgrasp.eval import metrics
from dgrasp.eval.comparison import data_stamp
from dgrasp.eval.evaluator import (
    Cost,
    Progress,
    evaluate_labels,
    evaluation_steps,
    grasp_steps,
    parts_of,
    run_episodes,
    shifted,
    summed,
)
from dgrasp.eval.summary import Result, Row, summarise
from dgrasp.methods.method import Method
from dgrasp.motion.files import read_targets
from dgrasp.motion.paths import PATHS
from dgrasp.motion.targets import EASY_FILE, OWN_SETS, TargetSet, draw_targets, easy_targets
from dgrasp.pool import Pool, PoolSpec, make_pool
from dgrasp.types import Array, EpisodeRecord

FLOOR = 0.0
"""m. Height of the ground under the authors' table. There is no ground here, so an episode ends at this height."""
ON_FLOOR = "object fell to the floor"


@dataclass(frozen=True)
class Motions:
    """The outcome of an experiment.

    records, targets: the episodes and the indices of their targets in the set, ordered by label, then by target.
    stable: (n_labels,) bool, which grasps passed the stability test. steps: control steps of a motion.
    poses_per_target: 1 for a target that stands still, more for a trajectory. events: what the pools report.
    """

    records: list[EpisodeRecord]
    targets: list[int]
    stable: Array
    steps: int
    poses_per_target: int
    cost: Cost
    events: list[str]


def usual_set(choice: DataChoice) -> str:
    """The default targets: "easy", the authors', if the data has their file, else "near", which resembles them."""
    return "easy" if (choice.root / "labels" / EASY_FILE).is_file() else "near"


def choose_targets(config: Config, choice: DataChoice) -> TargetSet:
    """The set that `motion.targets` names; raises `DataError` if there is none."""
    name, period = config.motion.targets, config.control_period
    if name == "easy":
        path = choice.root / "labels" / EASY_FILE
        if not path.is_file():
            raise DataError(f"{path}: no such file; the authors' targets come with their labels: give a folder that "
                            "has them with --data, or choose other targets, such as --motion near")
        return easy_targets(path)
    if name in OWN_SETS:
        return OWN_SETS[name](config.seed)
    if name in PATHS:
        return PATHS[name](period)
    path = Path(os.path.expanduser(str(name)))
    if not path.is_file():
        known = ", ".join(("easy", *OWN_SETS, *PATHS))
        raise DataError(f"motion.targets: {str(name)!r} is neither {known} nor a file")
    return read_targets(path, period)


def run_motions(
    spec: PoolSpec, method: Method, targets: TargetSet, progress: Progress | None = None
) -> Motions:
    """Grasp the labels of `spec` and move them to targets. Raises `DataError` if no grasp is stable."""
    config, motion = spec.config, spec.config.motion
    per_label = motion.per_label
    if per_label is None and targets.name in ("easy", *OWN_SETS):
        per_label = 1
    which = draw_targets(len(targets.T), len(spec.labels), per_label, np.random.default_rng(config.seed))
    steps = max(motion.steps, targets.T.shape[1])
    episode = grasp_steps(method, config) + steps
    test_steps = evaluation_steps(spec, method)
    total = len(which) * len(parts_of(spec)) * episode + (test_steps if motion.stable_alone else 0)
    stable: Array = np.ones(len(spec.labels), bool)
    done = 0
    costs: list[Cost] = []
    events: list[str] = []
    if motion.stable_alone:
        stable, cost, events = stable_grasps(*method.grasping(spec), shifted(progress, 0, total))
        costs, done = [cost], test_steps
    spec = dataclasses.replace(spec, labels=[label for label, ok in zip(spec.labels, stable, strict=True) if ok])
    total = done + len(which) * len(parts_of(spec)) * episode
    rounds: list[list[EpisodeRecord]] = [[] for _ in which]
    for part in parts_of(spec):
        labels = spec.labels[part]
        pool = make_pool(dataclasses.replace(spec, labels=labels))
        try:
            for made, row in zip(rounds, which[:, stable][:, part], strict=True):
                path = targets.place(row, labels)
                records, cost = move(pool, method, config, path, steps, shifted(progress, done, total))
                made += records
                costs.append(cost)
                done += episode
            events += pool.drain_events()
        finally:
            pool.close()
    return Motions(
        [records[i] for i in range(len(spec.labels)) for records in rounds],
        which[:, stable].T.ravel().tolist(), stable, steps, targets.T.shape[1], summed(costs), events,
    )  # fmt: skip


def stable_grasps(
    method: Method, spec: PoolSpec, progress: Progress | None = None
) -> tuple[Array, Cost, list[str]]:
    """(N,) bool: which of a method's grasps of the labels pass the stability test; also the test's cost and events.

    method, spec: as `Method.grasping` returns them. Raises `DataError` if no grasp passes.
    """
    records, cost, events = evaluate_labels(spec, method, progress)
    window_s = spec.config.eval.window_s
    stable = np.array([metrics.success(record, window_s) for record in records], bool)
    if not stable.any():
        raise DataError(f"none of the {len(stable)} grasps passes the stability test of {window_s:g} "
                        "s, so there is nothing to move; motion.stable_alone=false moves unstable grasps too")
    return stable, cost, events


def move(
    pool: Pool, method: Method, config: Config, path: Array, steps: int, progress: Progress | None = None
) -> tuple[list[EpisodeRecord], Cost]:
    """Run one episode per label: the grasp, then `steps` control steps along the path (N, P, 4, 4) of T_WG.

    A method without a separate grasping phase gets the same total number of steps, and the first target from its first
    step.
    """
    grasp = grasp_steps(method, config)
    first = grasp
    if not method.grasps_first:
        first, path = 0, np.concatenate([np.repeat(path[:, :1], grasp, axis=1), path], axis=1)
    begin = partial(pool.begin_motion, path, method.fingers(config.motion))
    recorder, cost = run_episodes(pool, method, grasp + steps, first, begin, progress)
    records = recorder.records(grasp, config.control_period, with_target=True)
    return [until_floor(record) for record in records], cost


def until_floor(record: EpisodeRecord) -> EpisodeRecord:
    """The episode up to and including the step of the motion in which the object reached the floor."""
    fallen = np.flatnonzero(record.T_WO[record.window_start :, 2, 3] <= FLOOR)
    if not fallen.size:
        return record
    stop = record.window_start + int(fallen[0]) + 1
    values = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    arrays: dict[str, Any] = {name: value[:stop] for name, value in values.items() if isinstance(value, np.ndarray)}
    return dataclasses.replace(record, terminated=ON_FLOOR, **arrays)


def motion_row(record: EpisodeRecord, target: int, follows: bool) -> Row:
    """The metrics of one motion.

    A row has object, index, target (its index in the set), MPE, geodesic error, and whether the object was carried to
    the end. For a trajectory (follows) it also has the mean errors along the path.
    """
    row: Row = {"object": record.label.object_id, "index": record.label.index, "target": target}
    measured = {"mpe_m": metrics.mpe_m(record), "geodesic_rad": metrics.geodesic_rad(record)}
    if follows and measured["mpe_m"] is not None:
        measured["path_mpe_m"] = float(metrics.position_errors_m(record).mean())
        measured["path_geodesic_rad"] = float(metrics.geodesic_errors_rad(record).mean())
    row.update({name: value for name, value in measured.items() if value is not None})
    row["carried"] = not record.terminated and bool(record.contacts[-1].any() and not record.table_contact[-1])
    if record.terminated:
        row["terminated"] = record.terminated
    return row


def motion_result(
    motions: Motions, method: Method, config: Config, choice: DataChoice, targets: TargetSet, labels: Sequence[Any]
) -> Result:
    """The result of an experiment on the chosen labels, with the paper's numbers if they are comparable."""
    rows = [
        motion_row(record, target, motions.poses_per_target > 1)
        for record, target in zip(motions.records, motions.targets, strict=True)
    ]
    motion = config.motion
    about = {
        "targets": targets.name,
        "n_targets": len(targets.T),
        "steps": motions.steps,
        **method.describe(motion),
        "n_grasps": len(motions.stable),
        "n_stable": int(motions.stable.sum()) if motion.stable_alone else None,
        "left_out": [f"{label.object_id}[{label.index}]" for label, ok in zip(labels, motions.stable, strict=True)
                     if not ok],
    }
    if not motion.stable_alone:
        del about["n_stable"], about["left_out"]
    return summarise(
        rows, method=method.name, engine=config.engine, window_s=config.eval.window_s, seed=config.seed,
        data=data_stamp(method, config, choice), cost=motions.cost, motion=about,
    )  # fmt: skip


def check_moves(method: Method) -> None:
    """Raise `ConfigError` for a method that cannot move objects."""
    if method.motion == "never":
        raise ConfigError(f"--motion: {method.name} holds a pose and moves nothing; expected --policy, --run, or "
                          "--baseline static_grasp")
