"""Evaluate a method on the labels of a config: grasps, or motions to targets."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping

from dgrasp.build import build_spec
from dgrasp.config.experiment import Config
from dgrasp.data import DataChoice
from dgrasp.eval.comparison import data_stamp
from dgrasp.eval.evaluator import evaluate_labels
from dgrasp.eval.meshes import build_bodies, build_interpenetration
from dgrasp.eval.motion import check_moves, choose_targets, motion_result, run_motions
from dgrasp.eval.summary import Result, label_row, summarise
from dgrasp.geometry.intersection import Body
from dgrasp.methods.method import Method
from dgrasp.motion.targets import TargetSet
from dgrasp.objects.body import ObjectBody
from dgrasp.pool import PoolSpec
from dgrasp.rl.run.interrupts import check_interrupted
from dgrasp.rl.run.progress import format_duration
from dgrasp.types import EpisodeRecord


def evaluate_choice(
    method: Method, config: Config, choice: DataChoice
) -> tuple[Result, list[EpisodeRecord], PoolSpec]:
    """Evaluate a method on the chosen labels."""
    spec = build_spec(choice, config)
    bodies = build_bodies(choice, spec.objects)
    measure = build_interpenetration(choice, config, spec.hand, bodies) if config.eval.interpenetration else None
    spec = method.prepare(spec, lambda: _surfaces(bodies))
    one_thread()
    records, cost, events = evaluate_labels(spec, method, _Progress())
    for event in events:
        print(f"warning: {event}", file=sys.stderr)
    window = config.eval.window_s
    rows = [label_row(r, window) if measure is None else label_row(r, window) | measure.measure(r) for r in records]
    result = summarise(
        rows, method=method.name, engine=config.engine, window_s=window, seed=config.seed,
        data=data_stamp(method, config, choice), cost=cost,
        interpenetration=None if measure is None else measure.report(),
    )  # fmt: skip
    return result, records, spec


def evaluate_motion(
    method: Method, config: Config, choice: DataChoice, targets: TargetSet | None = None
) -> tuple[Result, list[EpisodeRecord], PoolSpec]:
    """Evaluate a method that carries the chosen labels' objects to targets: those of `motion.targets` unless given."""
    check_moves(method)
    targets = targets or choose_targets(config, choice)
    chosen = build_spec(choice, config)
    spec = method.prepare(chosen, lambda: _surfaces(build_bodies(choice, chosen.objects)))
    one_thread()
    motions = run_motions(spec, method, targets, _Progress())
    for event in motions.events:
        print(f"warning: {event}", file=sys.stderr)
    return motion_result(motions, method, config, choice, targets, spec.labels), motions.records, spec


def one_thread() -> None:
    """Give torch one thread; the workers use the other cores. Comes late, because torch takes seconds to import."""
    import torch

    torch.set_num_threads(1)


def _surfaces(bodies: Mapping[str, ObjectBody]) -> dict[str, Body]:
    return {name: entry.body for name, entry in bodies.items()}


class _Progress:
    """Prints the progress of an evaluation: on one line of a terminal, otherwise after every tenth of the steps."""

    def __init__(self) -> None:
        self._tenth = -1
        self._start = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        check_interrupted()
        if sys.stderr.isatty():
            left = (time.monotonic() - self._start) / done * (total - done)
            end = "\n" if done == total else ""
            print(f"\revaluating: step {done} of {total}, {format_duration(left)} left ", end=end, file=sys.stderr)
        elif 10 * done // total > self._tenth:
            self._tenth = 10 * done // total
            print(f"evaluating: step {done} of {total}", file=sys.stderr, flush=True)
