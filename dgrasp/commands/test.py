"""Evaluate a policy or a baseline: `python test.py --baseline gt_pd`, `python test.py --run runs/NAME`."""

from __future__ import annotations

import argparse
import contextlib
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dgrasp.config.names import BASELINES, TABLES
from dgrasp.errors import ConfigError, DataError
from dgrasp.files.atomic import write_atomic
from dgrasp.files.outputs import check_outputs
from dgrasp.labels.sources import SOURCES
from raisim_like.registry import BATCHES

if TYPE_CHECKING:
    from dgrasp.eval.summary import Result
    from dgrasp.pool import PoolSpec
    from dgrasp.request import Asked, Request
    from dgrasp.types import EpisodeRecord
    from dgrasp.view.meshes import DisplayMeshes

HELP = """\
Evaluate grasps: the policy (or baseline) grasps, the table is taken away, and the object must not fall during the
window. Prints a table with a row per object, next to the paper's numbers if hand and labels are the paper's. With
--motion, the wrist then carries the object to target poses or along a trajectory.

examples:
  python test.py --baseline gt_pd                        hold the labels' poses with PD control
  python test.py --baseline gt_ik                        the same, with the contacts moved to the object's surface
  python test.py --run runs/dexycb_1 --split test        a policy that you trained
  python test.py --policy full_6000.pt --window 3.87     a policy that the authors published
  python test.py --baseline gt_pd --labels MY.npz --report out.html   charts, failures, replays in one file
  python test.py --cfg cfg/motion.yaml --policy full_6000.pt          motion synthesis, as in the paper
  python test.py --run runs/dexycb_1 --motion MY.csv                  to your own poses, or along your own path
  python test.py --table grasp --engine mujoco           a table of the paper; --budget 60 trains missing policies
  python test.py --baseline static_grasp [--policy full_6000.pt]      the fingers keep their pose as the wrist moves
  python test.py --baseline flat_rl --run runs/flat_rl_1              one policy grasps and moves; also learned_motion
"""

BESIDE_JSON = (".csv", ".md", ".tex")
"""Suffixes of the tables that are written beside the file of --json."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `test`."""
    parser.add_argument("--baseline", choices=BASELINES, help="a baseline of the paper; static_grasp takes its grasps "
                        "from --run or --policy, else from PD control on the labels; flat_rl and learned_motion need "
                        "training runs of their own")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--run", type=Path, metavar="DIR|pretrained", help="the last checkpoint of a training run, or "
                      "the shipped policy")
    what.add_argument("--policy", type=Path, metavar="FILE", help="a checkpoint, ours or one of the authors', or a "
                      "file of `dgrasp publish`")
    parser.add_argument("--table", choices=(*TABLES, "all"), help="fill a table of the paper with the trained "
                        "policies, and print how to train the missing ones")
    parser.add_argument("--budget", type=_minutes, metavar="MINUTES",
                        help="with --table: train missing policies for this long")
    parser.add_argument("--seeds", type=_numbers, default=[], metavar="K,K,...",
                        help="with --table: average over policies of these seeds (default: the config's seed)")
    parser.add_argument("--runs", type=Path, metavar="DIR",
                        help="with --table: folder of its runs and results (default: runs/tables)")
    parser.add_argument("--motion", metavar="easy|near|ood|circle|pour|FILE",
                        help="move the object to targets: the authors' (easy), this project's (near, ood), a path "
                             "(circle, pour) or a file of poses")
    parser.add_argument("--cfg", type=Path, metavar="FILE", help="config file (default: the run's, the policy's, or "
                        "cfg/dexycb.yaml)")
    parser.add_argument("--data", metavar="free|DIR", help="the free set, or a folder like the authors' release")
    parser.add_argument("--split", choices=("train", "test"), help="which labels (default: train)")
    parser.add_argument("--labels", metavar="SOURCE|FILE", help=f"{', '.join(SOURCES)}, or a label file")
    parser.add_argument("--objects", nargs="+", metavar="NAME", help="only these objects, such as 004_sugar_box")
    parser.add_argument("--engine", choices=list(BATCHES),
                        help="physics engine; warp (for a GPU) needs dgrasp[warp]")
    parser.add_argument("--window", type=float, metavar="SECONDS",
                        help="stability window (default: 5; the authors use 3.87)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write JSON, with CSV, Markdown and LaTeX beside it")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write one HTML page: table, charts, replays in 3D")
    parser.add_argument("--records", type=Path, metavar="DIR", help="store every sequence in a new folder, for `dgrasp "
                        "export`")
    parser.add_argument("--gif", type=Path, metavar="FILE", help="write a GIF of some of the grasps")
    parser.add_argument("--shapes", action="store_true", help="with --gif or --report: draw the collision shapes in "
                        "place of the surfaces")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys, such as seed=3 pool.workers=2")


def _numbers(text: str) -> list[int]:
    if not re.fullmatch(r"\d+(,\d+)*", text):
        raise argparse.ArgumentTypeError(f"{text!r}: expected seeds, whole numbers separated by commas, such as 1,2,3")
    return [int(word) for word in text.split(",")]


def _minutes(text: str) -> float:
    with contextlib.suppress(ValueError):
        minutes = float(text)
        if math.isfinite(minutes) and minutes > 0.0:
            return minutes
    raise argparse.ArgumentTypeError(f"{text!r}: expected a number of minutes above 0")


def main(arguments: argparse.Namespace) -> int:
    """Run the evaluation that the command line describes; returns the exit code."""
    if arguments.table is not None:
        from dgrasp.commands.tables import main as fill_tables

        return fill_tables(arguments)
    given = {"--budget": arguments.budget, "--seeds": arguments.seeds or None, "--runs": arguments.runs}
    alone = [name for name, value in given.items() if value is not None]
    if alone:
        raise ConfigError(f"{', '.join(alone)}: only valid with --table; add one, such as --table grasp, or leave out "
                          f"{', '.join(alone)}")
    if arguments.json is not None and arguments.json.suffix.lower() in BESIDE_JSON:
        raise ConfigError(f"--json {arguments.json}: a table with this suffix is written beside the JSON; expected a "
                          f"name such as {arguments.json.with_suffix('.json')}")
    if arguments.shapes and arguments.gif is None and arguments.report is None:
        raise ConfigError("--shapes: only valid with --gif or --report; add one of them, or leave out --shapes")
    _check_outputs(arguments)

    from dgrasp.evaluation import evaluate_choice, evaluate_motion
    from dgrasp.export.sequence import check_folder
    from dgrasp.request import make_request

    if arguments.records is not None:
        check_folder(arguments.records)
    request = make_request(asked_by(arguments))
    config, choice = request.config, request.choice
    print(choice.describe(), flush=True)
    evaluation = evaluate_choice if config.motion.targets is None else evaluate_motion
    result, records, spec = evaluation(request.method, config, choice)
    _write(arguments, request, result, records, spec)
    return 0


def _write(
    arguments: argparse.Namespace, request: Request, result: Result, records: list[EpisodeRecord], spec: PoolSpec
) -> None:
    """Print a result, and write the files that the options name."""
    from dgrasp.eval import failures, output
    from dgrasp.eval.agreement import find_agreement
    from dgrasp.eval.latex import write_latex
    from dgrasp.export.collect import display_meshes, sequences
    from dgrasp.export.sequence import write_folder
    from dgrasp.report.page import write_report

    config, choice = request.config, request.choice
    extra: dict[str, Any] = {}
    lines: list[str] = []
    if arguments.policy is not None and result.motion is None:
        agreement = find_agreement(arguments.policy, choice.labels, [bool(row["success"]) for row in result.per_label])
        if agreement is not None:
            lines = agreement.lines()
            extra["raisim"] = agreement.plain()
    if result.motion is None:
        extra |= failures.report(result.per_label, result.window_s, config.control_period)
    if arguments.json is not None:
        output.write_json(result, arguments.json, extra)
        tables = (output.write_csv, output.write_markdown, write_latex)
        for suffix, write_table in zip(BESIDE_JSON, tables, strict=True):
            write_table(result, arguments.json.with_suffix(suffix))
    try:
        if any(shown is not None for shown in (arguments.report, arguments.records, arguments.gif)):
            meshes = display_meshes(choice, spec)
            if arguments.records is not None:
                write_folder(arguments.records, sequences(result, records, spec, choice, meshes))
            if arguments.report is not None:
                write_report(arguments.report, result, records, meshes, extra, arguments.shapes)
            if arguments.gif is not None:
                drawn = {name: of.colliding() for name, of in meshes.items()} if arguments.shapes else meshes
                write_gif(arguments.gif, records, drawn)
    finally:
        # The table comes last: `| head` closes the pipe early, and the files must be complete by then. It is printed
        # even if writing a file failed.
        output.print_table(result)
        print("\n".join(lines), end="\n" if lines else "")


def asked_by(arguments: argparse.Namespace) -> Asked:
    """What the options ask for; a key=value on the command line takes precedence over the option for the same key."""
    from dgrasp.request import Asked

    # In `--objects A B seed=3`, a word with an equals sign is an override, not an object.
    named = arguments.objects or []
    objects = None if arguments.objects is None else [name for name in named if "=" not in name]
    given = {
        "data": arguments.data,
        "labels.split": arguments.split,
        "labels.source": arguments.labels,
        "labels.objects": objects,
        "engine": arguments.engine,
        "eval.window_s": arguments.window,
        "motion.targets": arguments.motion,
    }
    return Asked(
        baseline=arguments.baseline, policy=arguments.policy, run=arguments.run, cfg=arguments.cfg,
        values={key: value for key, value in given.items() if value is not None},
        overrides=[*(word for word in named if "=" in word), *arguments.overrides],
    )  # fmt: skip


def _check_outputs(arguments: argparse.Namespace) -> None:
    given = {"--json": arguments.json, "--report": arguments.report, "--gif": arguments.gif}
    outputs = {name: path for name, path in given.items() if path is not None}
    if arguments.json is not None:
        beside = [arguments.json.with_suffix(suffix) for suffix in BESIDE_JSON]
        there = [str(path) for path in beside if path.exists()]
        if there and not arguments.json.exists():
            raise DataError(f"--json {arguments.json}: {there[0]} would be written beside it, but exists already; "
                            "choose another name")
        outputs |= {f"the {path.suffix} beside --json": path for path in beside}
    inputs = [arguments.cfg, arguments.policy, *(Path(word) for word in (arguments.labels, arguments.motion) if word)]
    check_outputs(outputs, inputs)


def write_gif(
    path: Path, records: Sequence[EpisodeRecord], meshes: Mapping[str, DisplayMeshes], count: int = 6
) -> None:
    """Write a GIF of up to `count` episodes side by side, spread evenly over the labels."""
    from dgrasp.view.frames import gif_bytes, record_pictures, tile

    there = [record for record in records if len(record.gc)]
    if not there:
        raise DataError(f"{path}: no episode lasted a single step, so there is nothing to show in a GIF")
    chosen = [there[i * len(there) // min(count, len(there))] for i in range(min(count, len(there)))]
    clips = [list(record_pictures(r, meshes[r.label.object_id], every=5, size=(320, 240))) for r in chosen]
    write_atomic(path, gif_bytes(tile(clips, columns=min(len(clips), 3)), 5 * chosen[0].dt))
