"""`dgrasp runs`: list run directories, or compare two of them."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dgrasp.config.sections import INERTIA
from dgrasp.config.values import flat_keys
from dgrasp.errors import ConfigError
from dgrasp.rl.run.record import Run, read_run

HELP = """\
List training runs with state, data, engine, success and cost, or compare two runs.

examples:
  dgrasp runs                         list the runs in runs/
  dgrasp runs /somewhere/runs         list the runs in another folder
  dgrasp runs runs/fast_1 runs/fast_2 show differences, and success at the same number of control steps
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `runs`."""
    parser.add_argument("paths", nargs="*", type=Path, metavar="DIR",
                        help="a folder of runs (default: runs), or two runs")


def main(arguments: argparse.Namespace) -> int:
    """List or compare; returns the exit code."""
    paths: list[Path] = arguments.paths or [Path("runs")]
    if len(paths) > 2:
        raise ConfigError(f"got {len(paths)} folders; expected a folder of runs, or two runs to compare")
    if len(paths) == 2:
        _compare(*map(read_run, paths))
        return 0
    root = paths[0]
    if not root.is_dir():
        raise ConfigError(f"{root}: no such folder; train.py writes runs to runs/NAME_K, or to the folder of --run")
    found = [root] if (root / "config.yaml").is_file() else sorted(file.parent for file in root.glob("*/config.yaml"))
    if not found:
        print(f"{root}: no runs in this folder")
        return 0
    table = Table("run", "state", "data", "engine", "objects", *_COST, box=None)
    for column in table.columns[5:]:
        column.justify = "right"
    refused = []
    for path in found:
        try:
            run = read_run(path)
        except ConfigError as error:
            table.add_row(escape(path.name), "unreadable")
            refused.append(str(error))
            continue
        table.add_row(escape(path.name), run.state, _data(run), run.config.engine, _objects(run), *_cost(run))
    _print(table)
    for line in refused:
        print(f"\n{line}")
    return 0


_COST = ("epoch", "control steps", "core-hours", "success", "best")


def _cost(run: Run) -> list[str]:
    last = f"{run.curve[-1][1]:.3f}" if run.curve else "-"
    best = "-" if run.best is None else f"{run.best:.3f}"
    return [
        f"{run.number('epoch'):.0f}/{run.epochs}", f"{run.number('control_steps'):,.0f}",
        f"{run.number('core_hours'):.2f}", last, best,
    ]  # fmt: skip


def _data(run: Run) -> str:
    told = f"{run.data.get('kind', '?')} {run.data.get('split', '')}".strip()
    inertia = INERTIA.get(run.data.get("inertia", ""))
    return f"{told}, {inertia}" if inertia else told


def _objects(run: Run) -> str:
    names = run.config.labels.objects
    return "all" if not names else names[0] if len(names) == 1 else f"{len(names)} objects"


def _compare(a: Run, b: Run) -> None:
    table = Table("", escape(a.path.name), escape(b.path.name), box=None)
    table.add_row("state", a.state, b.state)
    table.add_row("data", _data(a), _data(b))
    for name, *values in zip(_COST, _cost(a), _cost(b), strict=True):
        table.add_row(name, *values)
    one, other = flat_keys(a.config.model_dump(mode="json")), flat_keys(b.config.model_dump(mode="json"))
    for key in sorted(key for key in one if one[key] != other[key]):
        table.add_row(key, escape(str(one[key])), escape(str(other[key])), style="bold")
    _print(table)
    if not (a.curve and b.curve):
        return
    curves = Table("control steps", *(escape(f"success of {run.path.name}") for run in (a, b)), box=None)
    for column in curves.columns:
        column.justify = "right"
    # Up to the end of the shorter run; each cell is the success of the latest evaluation so far.
    until = min(a.curve[-1][0], b.curve[-1][0])
    for steps in sorted({steps for steps, _ in a.curve + b.curve if steps <= until}):
        curves.add_row(f"{steps:,}", *(f"{_at(run, steps):.3f}" for run in (a, b)))
    print()
    _print(curves)


def _at(run: Run, steps: int) -> float:
    known = [success for made, success in run.curve if made <= steps]
    return known[-1] if known else float("nan")


def _print(table: Table) -> None:
    # A table that goes to a file or a pipe is not limited to a terminal's width.
    console = Console()
    (console if console.is_terminal else Console(width=200)).print(table)
