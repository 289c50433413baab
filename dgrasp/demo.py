"""`make demo`: train briefly on the free set, test the policy beside the PD baseline, and say what is next."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from dgrasp.baselines import PdBaseline
from dgrasp.config import Config, load_config
from dgrasp.data import resolve
from dgrasp.errors import ConfigError
from dgrasp.eval import output
from dgrasp.eval.method import PolicyMethod
from dgrasp.eval.summary import Result
from dgrasp.export.collect import display_meshes
from dgrasp.paths import package_file
from dgrasp.report.page import write_report
from dgrasp.rl import checkpoint
from dgrasp.test import evaluate_choice, write_gif
from dgrasp.train import next_run, start_run, train

HELP = """\
Train briefly on the shipped hand, objects and labels, then test the policy beside the PD baseline.
Leaves a run directory with checkpoints, TensorBoard events, and for both a report with replays in 3D (policy.html,
gt_pd.html) and its numbers (.json), and grasps.gif.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `demo`."""
    parser.add_argument("--run", type=Path, metavar="DIR", help="run directory (default: runs/demo_K, a new one)")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys, such as ppo.epochs=20")


def main(arguments: argparse.Namespace) -> int:
    """Run the demo; returns the exit code."""
    config = load_config(package_file("cfg/demo.yaml"), list(arguments.overrides))
    choice = resolve(config)
    run_dir = arguments.run or next_run(config.name)
    if run_dir.exists():
        raise ConfigError(f"{run_dir} exists already; choose another --run")
    print(choice.describe(), flush=True)
    torch.set_num_threads(1)
    start_run(run_dir, config, choice)
    print(f"training {config.ppo.epochs} epochs on {len(choice.labels.labels)} labels ...", flush=True)
    train(run_dir, config, choice)
    policy = checkpoint.load_policy(checkpoint.latest(run_dir))
    results = {}
    for method in (PdBaseline(), PolicyMethod(policy)):
        print(f"testing {method.name} ...", flush=True)
        result, records, spec = evaluate_choice(method, config, choice)
        results[method.name] = result
        output.write_json(result, run_dir / f"{method.name}.json")
        write_report(run_dir / f"{method.name}.html", result, records, display_meshes(choice, spec))
    write_gif(run_dir / "grasps.gif", records, spec)
    _print(results, config)
    # An environment that is not active is named by its folder, so that the lines can be typed as they are.
    bin_dir = "" if shutil.which("dgrasp") else os.path.relpath(Path(sys.executable).parent) + os.sep
    print(
        f"\nlook at it:       {run_dir / 'policy.html'} in a browser; {bin_dir}tensorboard --logdir {run_dir.parent}\n"
        f"train longer:     {bin_dir}dgrasp train --cfg cfg/dexycb.yaml --data free\n"
        f"one object:       {bin_dir}dgrasp train --cfg cfg/dexycb.yaml --data free labels.objects=[004_sugar_box]\n"
        f"test it again:    {bin_dir}dgrasp test --run {run_dir} --split test\n"
        f"your own labels:  {bin_dir}dgrasp test --baseline gt_pd --labels FILE"
    )
    return 0


def _print(results: dict[str, Result], config: Config) -> None:
    """One table: success of both methods per object."""
    first = next(iter(results.values()))
    table = Table(title=f"success on the free set, window {config.eval.window_s:g} s", title_justify="left")
    table.add_column("object")
    table.add_column("n", justify="right")
    for name in results:
        table.add_column(name, justify="right")
    for name, means in first.per_object.items():
        table.add_row(name, f"{means['n']:g}", *(f"{r.per_object[name]['success']:.2f}" for r in results.values()))
    table.add_section()
    table.add_row(
        "mean over objects", str(first.n_labels), *(f"{r.mean_over_objects['success']:.2f}" for r in results.values())
    )
    Console().print(table)
    print("own hand and labels: not comparable with the paper; minutes of training, not the paper's days")


if __name__ == "__main__":
    from dgrasp.cli import run_command

    sys.exit(run_command("demo", sys.argv[1:]))
