"""What was trained: `dgrasp runs` lists run directories, `dgrasp runs A B` compares two."""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dgrasp.config.experiment import Config, load_config
from dgrasp.config.values import flat_keys
from dgrasp.errors import ConfigError
from dgrasp.rl.run.checkpoint import saved
from dgrasp.rl.run.lock import is_running
from dgrasp.rl.run.log import CSV_NAME, read_plan

HELP = """\
List training runs with state, data, engine, success and cost; compare two of them.

examples:
  dgrasp runs                         all below runs/
  dgrasp runs /somewhere/runs         all below another folder
  dgrasp runs runs/fast_1 runs/fast_2 what differs, and success at the same number of control steps
"""


@dataclass(frozen=True)
class Run:
    """A run directory as it is now; `rows` are those of its progress.csv, `plan` what the learner was to do."""

    path: Path
    config: Config
    data: dict[str, Any]
    rows: list[dict[str, str]]
    plan: dict[str, Any] = field(default_factory=dict)

    @property
    def state(self) -> str:
        """running, finished, stopped (it can be resumed), or new."""
        if is_running(self.path):
            return "running"
        if not self.rows or not saved(self.path):
            return "new"
        out_of_time = self.number("seconds") >= 60.0 * (self.config.ppo.max_minutes or float("inf"))
        return "finished" if self.complete or out_of_time else "stopped"

    @property
    def complete(self) -> bool:
        """Whether all epochs are made that `ppo.epochs` and `ppo.max_steps` allow, whatever the time they took."""
        return self.number("epoch") >= self.epochs

    @property
    def epochs(self) -> int:
        """How many epochs `ppo.epochs` and `ppo.max_steps` allow."""
        ppo, log = self.config.ppo, self.plan
        if (ppo.epochs, ppo.max_steps) == (log.get("epochs"), log.get("max_steps")):
            return int(log["last_epoch"])
        envs = log.get("environments", self.data.get("n_labels"))
        if not self.rows or not isinstance(envs, int):
            return ppo.epochs
        return self.config.last_epoch(envs, int(self.number("epoch")), int(self.number("control_steps")))

    @property
    def curve(self) -> list[tuple[int, float]]:
        """(control steps, success) of each evaluation."""
        return [(int(row["control_steps"]), float(row["success"])) for row in self.rows if row.get("success")]

    @property
    def best(self) -> float | None:
        """The best evaluation's success, or None before the first."""
        return max((success for _, success in self.curve), default=None)

    def until(self, epoch: int) -> Run:
        """The run as it was when an epoch was complete."""
        return replace(self, rows=[row for row in self.rows if int(row["epoch"]) <= epoch])

    def number(self, column: str) -> float:
        """The last value in a column of progress.csv; 0 where there is none."""
        return float(self.rows[-1].get(column) or 0.0) if self.rows else 0.0


def read_run(path: Path) -> Run:
    """A run directory; `ConfigError` if train.py did not make it."""
    if not (path / "config.yaml").is_file():
        raise ConfigError(f"{path}: not a run directory (no config.yaml); expected one that train.py made")
    data: Any = {}
    if (path / "data.json").is_file():
        try:
            data = json.loads((path / "data.json").read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path / 'data.json'}: not JSON ({error}); was it changed by hand?") from None
    rows: list[dict[str, str]] = []
    if (path / CSV_NAME).is_file():
        # A power cut leaves NULs, an editor other things; such rows are not counted.
        text = (path / CSV_NAME).read_text(encoding="utf-8", errors="replace").replace("\0", "")
        rows = [row for row in csv.DictReader(io.StringIO(text, newline="")) if None not in row and _is_sound(row)]
    return Run(path, load_config(path / "config.yaml"), data if isinstance(data, dict) else {}, rows, read_plan(path))


def _is_sound(row: dict[str, str]) -> bool:
    """Whether the columns that are read here hold numbers."""
    try:
        int(row["epoch"]), int(row["control_steps"])
        numbers = [float(row["seconds"]), *(float(row.get(name) or 0.0) for name in ("core_hours", "success"))]
        return all(map(math.isfinite, numbers))
    except (KeyError, TypeError, ValueError):
        return False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `runs`."""
    parser.add_argument("paths", nargs="*", type=Path, metavar="DIR",
                        help="a folder of runs (default: runs), or two runs")


def main(arguments: argparse.Namespace) -> int:
    """List or compare; returns the exit code."""
    paths: list[Path] = arguments.paths or [Path("runs")]
    if len(paths) > 2:
        raise ConfigError(f"{len(paths)} folders; expected a folder of runs, or two runs to compare")
    if len(paths) == 2:
        _compare(*map(read_run, paths))
        return 0
    root = paths[0]
    if not root.is_dir():
        raise ConfigError(f"{root}: no such folder; train.py makes runs/NAME_K, or where --run says")
    found = [root] if (root / "config.yaml").is_file() else sorted(file.parent for file in root.glob("*/config.yaml"))
    if not found:
        print(f"{root}: no runs there")
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
    return f"{run.data.get('kind', '?')} {run.data.get('split', '')}".strip()


def _objects(run: Run) -> str:
    names = run.config.labels.objects
    return "all" if not names else names[0] if len(names) == 1 else f"{len(names)} of them"


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
    # Up to where the shorter one went, success as last evaluated.
    until = min(a.curve[-1][0], b.curve[-1][0])
    for steps in sorted({steps for steps, _ in a.curve + b.curve if steps <= until}):
        curves.add_row(f"{steps:,}", *(f"{_at(run, steps):.3f}" for run in (a, b)))
    print()
    _print(curves)


def _at(run: Run, steps: int) -> float:
    known = [success for made, success in run.curve if made <= steps]
    return known[-1] if known else float("nan")


def _print(table: Table) -> None:
    # A table that goes into a file is not squeezed to a terminal's width.
    console = Console()
    (console if console.is_terminal else Console(width=200)).print(table)
