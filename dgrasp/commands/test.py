"""Evaluate a policy or a baseline: `python test.py --baseline gt_pd`, `python test.py --run runs/NAME`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from dgrasp.commands.tables import main as fill_tables
from dgrasp.data import resolve
from dgrasp.errors import ConfigError, DataError
from dgrasp.eval import failures, output
from dgrasp.eval.agreement import find_agreement
from dgrasp.eval.latex import write_latex
from dgrasp.eval.motion import usual_set
from dgrasp.evaluation import evaluate_choice, evaluate_motion
from dgrasp.export.collect import display_meshes, sequences
from dgrasp.export.film import record_pictures
from dgrasp.export.sequence import check_folder, write_folder
from dgrasp.files.atomic import write_atomic
from dgrasp.files.outputs import check_outputs
from dgrasp.methods.static_grasp import StaticGrasp
from dgrasp.report.page import write_report
from dgrasp.request import add_arguments, check_task, config_of, method_for
from dgrasp.types import EpisodeRecord
from dgrasp.view.frames import gif_bytes, tile
from dgrasp.view.meshes import DisplayMeshes

__all__ = ["HELP", "add_arguments", "main", "write_gif"]

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


def main(arguments: argparse.Namespace) -> int:
    """Run the evaluation that the command line describes; returns the exit code."""
    torch.set_num_threads(1)
    if arguments.table is not None:
        return fill_tables(arguments)
    given = {"--budget": arguments.budget, "--seeds": arguments.seeds or None, "--runs": arguments.runs}
    alone = [name for name, value in given.items() if value is not None]
    if alone:
        raise ConfigError(f"{', '.join(alone)}: only a table has a use for that; name one, such as --table grasp, or "
                          f"leave {', '.join(alone)} away")
    if arguments.json is not None and arguments.json.suffix.lower() in BESIDE_JSON:
        raise ConfigError(f"--json {arguments.json}: that is where a table goes that is written beside the JSON; "
                          f"expected a name such as {arguments.json.with_suffix('.json')}")
    _check_outputs(arguments)
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
        for suffix, write_table in BESIDE_JSON.items():
            write_table(result, arguments.json.with_suffix(suffix))
    try:
        if any(shown is not None for shown in (arguments.report, arguments.records, arguments.gif)):
            meshes = display_meshes(choice, spec)
            if arguments.records is not None:
                write_folder(arguments.records, sequences(result, records, spec, choice, meshes))
            if arguments.report is not None:
                write_report(arguments.report, result, records, meshes, extra)
            if arguments.gif is not None:
                write_gif(arguments.gif, records, meshes)
    finally:
        # Last, for who reads only its first lines closes the pipe; and whatever became of the files.
        output.print_table(result)
        print("\n".join(lines), end="\n" if lines else "")
    return 0


def _check_outputs(arguments: argparse.Namespace) -> None:
    given = {"--json": arguments.json, "--report": arguments.report, "--gif": arguments.gif}
    outputs = {name: path for name, path in given.items() if path is not None}
    if arguments.json is not None:
        beside = [arguments.json.with_suffix(suffix) for suffix in BESIDE_JSON]
        there = [str(path) for path in beside if path.exists()]
        if there and not arguments.json.exists():
            raise DataError(f"--json {arguments.json}: {there[0]} would be written beside it, and is there already; "
                            "choose another name")
        outputs |= {f"the {path.suffix} beside --json": path for path in beside}
    inputs = [arguments.cfg, arguments.policy, *(Path(word) for word in (arguments.labels, arguments.motion) if word)]
    check_outputs(outputs, inputs)


def write_gif(
    path: Path, records: Sequence[EpisodeRecord], meshes: Mapping[str, DisplayMeshes], count: int = 6
) -> None:
    """A GIF of some episodes side by side, spread over the labels."""
    there = [record for record in records if len(record.gc)]
    if not there:
        raise DataError(f"{path}: no episode lasted a single step, so that there is nothing to show in a GIF")
    chosen = [there[i * len(there) // min(count, len(there))] for i in range(min(count, len(there)))]
    clips = [list(record_pictures(r, meshes[r.label.object_id], every=5, size=(320, 240))) for r in chosen]
    write_atomic(path, gif_bytes(tile(clips, columns=3), 5 * chosen[0].dt))
