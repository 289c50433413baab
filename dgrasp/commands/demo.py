"""`make demo`: test PD control and the shipped policy on the free labels, then train a policy for a few minutes."""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from dgrasp.commands.test import write_gif
from dgrasp.config.experiment import Config, load_config, make_config
from dgrasp.errors import ConfigError
from dgrasp.files.paths import data_root, package_file
from dgrasp.rl.run.folder import PRETRAINED_FILE

if TYPE_CHECKING:
    from dgrasp.eval.summary import Result
    from dgrasp.methods.method import Method
    from dgrasp.rl.run.policies import SavedPolicy

HELP = """\
Run a short demonstration on the shipped hand, objects and labels:

  1. test PD control on labels that no policy was trained on
  2. test the shipped policy, if there is one, on the same labels
  3. let the shipped policy carry six objects to target poses
  4. train another policy from scratch for a few minutes

The run directory receives reports that replay grasps in 3D (gt_pd.html, policy.html, motion.html), their numbers
(.json), grasps.gif, and the checkpoints and TensorBoard events of the training.
"""
_OBJECT = "004_sugar_box"
# Episodes are shorter and the pose weighs less than in the recipe. Three minutes are too short to learn a long hold,
# and shorter episodes give more frequent updates.
_TRAINING = ("name=demo", "data=free", f"labels.objects=[{_OBJECT}]", "env.episode_steps=100", "env.reward.pose=0.1",
             "ppo.max_minutes=3", "ppo.epochs=1000", "checkpoint.every=5", "checkpoint.keep=2", "eval.every=1000",
             "eval.gif=false")  # fmt: skip
_TEST = ("data=free", "engine=mujoco", "physics.preset=faithful", "labels.split=test", "labels.limit_per_object=1")
_MOTION = ("motion.targets=near", "motion.stable_alone=false")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `demo`."""
    parser.add_argument("--run", type=Path, metavar="DIR", help="run directory (default: runs/demo_K, a new one)")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys, such as ppo.max_minutes=10")


def main(arguments: argparse.Namespace) -> int:
    """Run the demo; returns the exit code."""
    words = list(arguments.overrides)
    config = load_config(package_file("cfg/fast.yaml"), [*_TRAINING, *words])
    if arguments.run is not None and arguments.run.exists():
        raise ConfigError(f"{arguments.run} exists already; choose another --run")

    from dgrasp.data import resolve
    from dgrasp.eval import output
    from dgrasp.evaluation import one_thread
    from dgrasp.rl.run.policies import read_policy
    from dgrasp.rl.run.record import read_run
    from dgrasp.training import next_run, start_run, train

    choice = resolve(config)
    run_dir = arguments.run or next_run(config.name)
    print(choice.describe(), flush=True)
    one_thread()
    start_run(run_dir, config, choice, new=True)
    file = data_root() / PRETRAINED_FILE
    saved = read_policy(file) if file.is_file() else None
    results = _test(saved, run_dir, words)
    if saved is not None:
        _carry(saved, run_dir, words)
    print(f"\ntraining a policy from scratch on {len(choice.labels.labels)} labels of {_OBJECT} ...", flush=True)
    train(run_dir, config, choice)
    trained = read_run(run_dir)
    print("\n" + output.notices(results["gt_pd"])[0])
    _print(results)
    print(f"\ntrained from scratch on {_OBJECT}: {trained.number('control_steps'):,.0f} control steps, success "
          f"{trained.number('success'):.2f}; longer training runs: docs/results.md")
    _print_next(run_dir, saved is not None)
    return 0


def _test(saved: SavedPolicy | None, run_dir: Path, words: list[str]) -> dict[str, Result]:
    """Test PD control, and the shipped policy if there is one, on one test label of each object."""
    from dgrasp.data import resolve
    from dgrasp.eval import output
    from dgrasp.evaluation import evaluate_choice
    from dgrasp.export.collect import display_meshes
    from dgrasp.methods import PdBaseline, method_of
    from dgrasp.report.page import write_report

    config = _config_of(saved, [*_TEST, *words])
    choice, results = resolve(config), {}
    print(f"\ntesting on {len(choice.labels.labels)} labels that no policy was trained on", flush=True)
    methods: list[Method] = [PdBaseline()]
    if saved is not None:
        methods.append(method_of(saved))
    for method in methods:
        print(f"testing {method.name} ...", flush=True)
        result, records, spec = evaluate_choice(method, config, choice)
        results[method.name] = result
        output.write_json(result, run_dir / f"{method.name}.json")
        meshes = display_meshes(choice, spec)
        write_report(run_dir / f"{method.name}.html", result, records, meshes)
    write_gif(run_dir / "grasps.gif", records, meshes)
    return results


def _carry(saved: SavedPolicy, run_dir: Path, words: list[str]) -> None:
    """Run motion synthesis with the paper's six objects."""
    from dgrasp.data import resolve
    from dgrasp.eval import output
    from dgrasp.eval.paper import MOTION_OBJECTS
    from dgrasp.evaluation import evaluate_motion
    from dgrasp.export.collect import display_meshes
    from dgrasp.methods import method_of
    from dgrasp.report.page import write_report

    objects = f"labels.objects=[{', '.join(MOTION_OBJECTS)}]"
    config = _config_of(saved, [*_TEST, objects, *_MOTION, *words])
    choice = resolve(config)
    print("carrying six objects to target poses ...", flush=True)
    result, records, spec = evaluate_motion(method_of(saved), config, choice)
    output.write_json(result, run_dir / "motion.json")
    write_report(run_dir / "motion.html", result, records, display_meshes(choice, spec))
    means = result.mean_over_labels
    print(f"{means['carried']:.0%} of them are still in the hand; mean distance to the target "
          f"{100 * means['mpe_m']:.1f} cm, dropped objects included")


def _config_of(saved: SavedPolicy | None, words: list[str]) -> Config:
    from dgrasp.request import published_values

    return make_config({} if saved is None else published_values(saved), str(PRETRAINED_FILE), words)


def _print(results: dict[str, Result]) -> None:
    """Print one table: the success of each method per object."""
    first = next(iter(results.values()))
    table = Table(title=f"success on the free set's test labels, window {first.window_s:g} s", title_justify="left")
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


def _print_next(run_dir: Path, shipped: bool) -> None:
    # If the virtual environment is not active, its folder is prefixed, so that the commands work as printed.
    bin_dir = "" if shutil.which("dgrasp") else shlex.quote(os.path.relpath(Path(sys.executable).parent) + os.sep)
    print(
        f"\nview the grasps:      open {run_dir / ('policy.html' if shipped else 'gt_pd.html')} in a browser\n"
        f"view the training:    {bin_dir}tensorboard --logdir {shlex.quote(str(run_dir.parent))}\n"
        f"train longer:         {bin_dir}dgrasp train --resume {shlex.quote(str(run_dir))} ppo.max_minutes=60\n"
        f"train on all objects: {bin_dir}dgrasp train --cfg cfg/fast.yaml --data free\n"
        + f"test shipped policy:  {bin_dir}dgrasp test --run pretrained --data free --split test\n" * shipped +
        f"test your own labels: {bin_dir}dgrasp test --baseline gt_pd --labels FILE"
    )
