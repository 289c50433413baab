"""Evaluate a policy or a baseline: `python test.py --baseline gt_pd`, `python test.py --run runs/NAME`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from dgrasp.baselines import BASELINES, TRAINED_BASELINES
from dgrasp.baselines.ik import IkBaseline
from dgrasp.baselines.static_grasp import StaticGrasp
from dgrasp.build import build_spec
from dgrasp.config import Config
from dgrasp.data import DataChoice, resolve
from dgrasp.errors import ConfigError, DataError
from dgrasp.eval import failures, output
from dgrasp.eval.agreement import find_agreement
from dgrasp.eval.evaluator import evaluate_labels
from dgrasp.eval.latex import write_latex
from dgrasp.eval.meshes import build_bodies, build_interpenetration
from dgrasp.eval.method import Method
from dgrasp.eval.motion import check_method, choose_targets, motion_result, run_motions, usual_set
from dgrasp.eval.summary import Result, label_row, summarise
from dgrasp.export.collect import display_meshes, sequences
from dgrasp.export.film import record_pictures
from dgrasp.export.sequence import check_folder, write_folder
from dgrasp.pool import PoolSpec
from dgrasp.report.page import write_report
from dgrasp.request import check_task, config_of, method_for
from dgrasp.rl import checkpoint
from dgrasp.rl.progress import format_duration
from dgrasp.tables.plan import NAMES
from dgrasp.types import EpisodeRecord
from dgrasp.view.frames import gif_bytes, tile
from dgrasp.view.meshes import DisplayMeshes
from raisim_like.engines import ENGINES

HELP = """\
Evaluate grasps: the policy (or baseline) grasps, the table is taken away, and the object must not fall
for the window. Prints a table per object, beside the paper's numbers where hand and labels are the paper's.
With --motion the wrist then carries the object to target poses, or along a trajectory.

examples:
  python test.py --baseline gt_pd                        hold the labels' poses with PD control
  python test.py --baseline gt_ik                        the same after drawing the contacts to the surface
  python test.py --run runs/dexycb_1 --split test        a policy that was trained here
  python test.py --policy full_6000.pt --window 3.87     a policy that the authors published
  python test.py --baseline gt_pd --labels MY.npz --report out.html   charts, failures, replays in one file
  python test.py --cfg cfg/motion.yaml --policy full_6000.pt          motion synthesis, as in the paper
  python test.py --run runs/dexycb_1 --motion MY.csv                  to your own poses, or along your own path
  python test.py --table grasp --engine mujoco           a table of the paper; --budget 60 trains what it lacks
  python test.py --baseline static_grasp [--policy full_6000.pt]      the fingers only hold while the wrist moves
  python test.py --baseline flat_rl --run runs/flat_rl_1              one policy for all of it; likewise learned_motion
"""

BESIDE_JSON = {".csv": output.write_csv, ".md": output.write_markdown, ".tex": write_latex}
"""The tables that are written beside the file of --json, by suffix."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `test`."""
    parser.add_argument("--baseline", choices=sorted([*BASELINES, *TRAINED_BASELINES]), help="a baseline of the "
                        "paper; static_grasp takes its grasps from --run or --policy, else from the labels by PD; "
                        "flat_rl and learned_motion are runs of their own")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--run", type=Path, metavar="DIR|pretrained", help="the last checkpoint of a training run, or "
                      "the policy that ships")
    what.add_argument("--policy", type=Path, metavar="FILE", help="a checkpoint, ours or one of the authors'; or "
                      "weights of `dgrasp publish`")
    parser.add_argument("--table", choices=(*NAMES, "all"), help="a table of the paper: evaluate what is there, say "
                        "how to train the rest")
    parser.add_argument("--budget", type=float, metavar="MINUTES", help="with --table: train what is missing, so long")
    parser.add_argument("--seeds", type=_numbers, default=[], metavar="K,K,...",
                        help="with --table: policies of these seeds, averaged (default: the config's one)")
    parser.add_argument("--runs", type=Path, metavar="DIR",
                        help="with --table: where its runs and results are (default: runs/tables)")
    parser.add_argument("--motion", metavar="easy|near|ood|circle|pour|FILE",
                        help="move the object to targets: the authors', own ones, a path, or a file of poses")
    parser.add_argument("--cfg", type=Path, metavar="FILE", help="experiment (default: the run's, the policy's, or "
                        "cfg/dexycb.yaml)")
    parser.add_argument("--data", metavar="free|DIR", help="the free set, or a folder like the authors' release")
    parser.add_argument("--split", choices=("train", "test"), help="which labels (default: train)")
    parser.add_argument("--labels", metavar="SOURCE|FILE", help="dexycb, grasptta, contactopt, or a label file")
    parser.add_argument("--objects", nargs="+", metavar="NAME", help="only these objects, such as 004_sugar_box")
    parser.add_argument("--engine", choices=ENGINES, help="physics engine")
    parser.add_argument("--window", type=float, metavar="SECONDS",
                        help="stability window (default: 5; the authors: 3.87)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write JSON, and CSV, markdown, LaTeX beside it")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write one HTML page: table, charts, replays in 3D")
    parser.add_argument("--records", type=Path, metavar="DIR", help="store every sequence in a new folder, for `dgrasp "
                        "export`")
    parser.add_argument("--gif", type=Path, metavar="FILE", help="write a GIF of some of the grasps")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys, such as seed=3 pool.workers=2")


def _numbers(text: str) -> list[int]:
    numbers = [int(word) for word in text.split(",")]
    if min(numbers) < 0:
        raise ValueError("a seed is at least 0")
    return numbers


def main(arguments: argparse.Namespace) -> int:
    """Run the evaluation that the command line describes; returns the exit code."""
    torch.set_num_threads(1)
    if arguments.table is not None:
        from dgrasp.tables.command import main as fill_tables  # which evaluates by means of this module

        return fill_tables(arguments)
    given = {"--budget": arguments.budget, "--seeds": arguments.seeds or None, "--runs": arguments.runs}
    alone = [name for name, value in given.items() if value is not None]
    if alone:
        raise ConfigError(f"{', '.join(alone)}: only a table has a use for that; name one, such as --table grasp, or "
                          f"leave {', '.join(alone)} away")
    for file in (arguments.json, arguments.report, arguments.gif):
        if file is not None and not file.parent.is_dir():
            raise DataError(f"{file}: the folder {file.parent} does not exist")
    if arguments.json is not None and arguments.json.suffix.lower() in BESIDE_JSON:
        raise ConfigError(f"--json {arguments.json}: that is where a table goes that is written beside the JSON; "
                          f"expected a name such as {arguments.json.with_suffix('.json')}")
    if arguments.records is not None:
        check_folder(arguments.records)
    method = method_for(arguments)
    config = config_of(arguments)
    check_task(method, config)
    choice = resolve(config)
    if (isinstance(method, StaticGrasp) or config.env.task != "grasp") and config.motion.targets is None:
        config = config.model_copy(update={"motion": config.motion.model_copy(update={"targets": usual_set(choice)})})
    print(choice.describe(), flush=True)
    evaluation = evaluate_choice if config.motion.targets is None else evaluate_motion
    result, records, spec = evaluation(method, config, choice)
    output.print_table(result)
    extra: dict[str, Any] = {}
    if arguments.policy is not None and result.motion is None:
        agreement = find_agreement(arguments.policy, choice.labels, [bool(row["success"]) for row in result.per_label])
        if agreement is not None:
            print("\n".join(agreement.lines()))
            extra["raisim"] = agreement.plain()
    if result.motion is None:
        extra |= failures.report(result.per_label, result.window_s, config.control_period)
    if arguments.json is not None:
        output.write_json(result, arguments.json, extra)
        for suffix, write_table in BESIDE_JSON.items():
            write_table(result, arguments.json.with_suffix(suffix))
    if any(shown is not None for shown in (arguments.report, arguments.records, arguments.gif)):
        meshes = display_meshes(choice, spec)
        if arguments.records is not None:
            write_folder(arguments.records, sequences(result, records, spec, choice, meshes))
        if arguments.report is not None:
            write_report(arguments.report, result, records, meshes, extra)
        if arguments.gif is not None:
            write_gif(arguments.gif, records, meshes)
    return 0


def evaluate_choice(
    method: Method, config: Config, choice: DataChoice
) -> tuple[Result, list[EpisodeRecord], PoolSpec]:
    """Evaluate a method on the chosen labels."""
    spec = build_spec(choice, config)
    bodies = build_bodies(choice, spec.objects)
    measure = build_interpenetration(choice, config, spec.hand, bodies) if config.eval.interpenetration else None
    if isinstance(method, IkBaseline):
        started = time.perf_counter()
        labels = method.correct(spec.labels, spec.hand, {name: entry.body for name, entry in bodies.items()})
        took = time.perf_counter() - started
        print(f"{method.name}: {len(labels)} labels corrected in {took:.1f} s", file=sys.stderr)
        spec = replace(spec, labels=labels)
    records, cost, events = evaluate_labels(spec, method, _Progress())
    for event in events:
        print(f"warning: {event}", file=sys.stderr)
    window = config.eval.window_s
    rows = [label_row(r, window) if measure is None else label_row(r, window) | measure.measure(r) for r in records]
    result = summarise(
        rows, method=method.name, engine=config.engine, window_s=window, seed=config.seed, data=choice.stamp(),
        cost=cost, interpenetration=None if measure is None else measure.report(),
    )  # fmt: skip
    return result, records, spec


def evaluate_motion(
    method: Method, config: Config, choice: DataChoice
) -> tuple[Result, list[EpisodeRecord], PoolSpec]:
    """Let a method carry the chosen labels' objects to the targets of `motion.targets`."""
    check_method(method)
    targets = choose_targets(config, choice)
    spec = build_spec(choice, config)
    motions = run_motions(spec, method, targets, _Progress())
    for event in motions.events:
        print(f"warning: {event}", file=sys.stderr)
    return motion_result(motions, method, config, choice, targets, spec.labels), motions.records, spec


def write_gif(
    path: Path, records: Sequence[EpisodeRecord], meshes: Mapping[str, DisplayMeshes], count: int = 6
) -> None:
    """A GIF of some episodes side by side, spread over the labels."""
    there = [record for record in records if len(record.gc)]
    if not there:
        raise DataError(f"{path}: no episode lasted a single step, so that there is nothing to show in a GIF")
    chosen = [there[i * len(there) // min(count, len(there))] for i in range(min(count, len(there)))]
    clips = [list(record_pictures(r, meshes[r.label.object_id], every=5, size=(320, 240))) for r in chosen]
    checkpoint.atomic_write_bytes(path, gif_bytes(tile(clips, columns=3), 5 * chosen[0].dt))


class _Progress:
    """Says how far an evaluation is: on one line of a terminal, else every tenth of the way."""

    def __init__(self) -> None:
        self._tenth = -1
        self._start = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        if sys.stderr.isatty():
            left = (time.monotonic() - self._start) / done * (total - done)
            end = "\n" if done == total else ""
            print(f"\revaluating: step {done} of {total}, {format_duration(left)} left ", end=end, file=sys.stderr)
        elif 10 * done // total > self._tenth:
            self._tenth = 10 * done // total
            print(f"evaluating: step {done} of {total}", file=sys.stderr, flush=True)
