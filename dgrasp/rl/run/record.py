"""The present content of a run directory: its config, its data, and the progress of its training."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from dgrasp.config.experiment import Config, load_config
from dgrasp.errors import ConfigError
from dgrasp.rl.run.folder import CSV_NAME, read_plan, saved
from dgrasp.rl.run.lock import is_running


@dataclass(frozen=True)
class Run:
    """The present content of a run directory. data: the data stamp. rows: of progress.csv. plan: of `write_plan`."""

    path: Path
    config: Config
    data: dict[str, Any]
    rows: list[dict[str, str]]
    plan: dict[str, Any] = field(default_factory=dict)

    @property
    def state(self) -> str:
        """running, finished, stopped (can be resumed), or new."""
        if is_running(self.path):
            return "running"
        if not self.rows or not saved(self.path):
            return "new"
        out_of_time = self.number("seconds") >= 60.0 * (self.config.ppo.max_minutes or float("inf"))
        return "finished" if self.complete or out_of_time else "stopped"

    @property
    def complete(self) -> bool:
        """Whether the run has made all epochs that `ppo.epochs` and `ppo.max_steps` allow, regardless of time."""
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
        """The success rate of the best evaluation after training began (`best.pt`); None before the first."""
        trained = [row for row in self.rows if int(row["epoch"]) > 0]
        return max((float(row["success"]) for row in trained if row.get("success")), default=None)

    def until(self, epoch: int) -> Run:
        """The run as it was at the end of an epoch."""
        return replace(self, rows=[row for row in self.rows if int(row["epoch"]) <= epoch])

    def number(self, column: str) -> float:
        """The last value in a column of progress.csv; 0 if there is none."""
        return float(self.rows[-1].get(column) or 0.0) if self.rows else 0.0


def read_run(path: Path) -> Run:
    """Read a run directory; `ConfigError` if it is not one that train.py made."""
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
        # A power cut can leave NULs and an editor other damage; skip such rows.
        text = (path / CSV_NAME).read_text(encoding="utf-8", errors="replace").replace("\0", "")
        rows = [row for row in csv.DictReader(io.StringIO(text, newline="")) if None not in row and _is_sound(row)]
    return Run(path, load_config(path / "config.yaml"), data if isinstance(data, dict) else {}, rows, read_plan(path))


def _is_sound(row: dict[str, str]) -> bool:
    """Whether the columns that `Run` reads hold finite numbers."""
    try:
        int(row["epoch"]), int(row["control_steps"])
        numbers = [float(row["seconds"]), *(float(row.get(name) or 0.0) for name in ("core_hours", "success"))]
        return all(map(math.isfinite, numbers))
    except (KeyError, TypeError, ValueError):
        return False
