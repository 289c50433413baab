"""The log of a training run: TensorBoard events, `progress.csv` and the progress on the screen."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rich.console import Console

from dgrasp.config.experiment import Config, dump_config
from dgrasp.config.tasks import TASKS
from dgrasp.errors import DataError
from dgrasp.files.atomic import write_atomic
from dgrasp.rl.collect import Incident
from dgrasp.rl.ppo import STATISTICS
from dgrasp.rl.run.events import EventFile
from dgrasp.rl.run.folder import CSV_NAME, write_description, write_plan
from dgrasp.rl.run.progress import TrainingProgress

RETURN, TERMINATED, TRUNCATED = "train/return", "train/terminated", "train/truncated"
HELD = "train/held"
"""Share of an epoch's training episodes that still held the object at their end; only with a hold (`env.hold`)."""
SUCCESS, CONTACT_RATIO = "eval/success", "eval/contact_ratio"
STEPS_PER_SECOND, PHYSICS_SHARE, UPDATE_SHARE = "speed/steps_per_second", "speed/physics_share", "speed/update_share"
LOST_WORKERS = "speed/lost_workers"
WORKERS = "speed/workers"
_FIXED_COLUMNS = ("epoch", "control_steps", "seconds", "core_hours")
_EVENTS_SHOWN = 3
_INCIDENTS_KEPT = 50


class Log:
    """The log of one run; a context manager that flushes and closes it.

    Values are logged under TensorBoard tags such as `ppo/kl`. `progress.csv` has one row per epoch; its columns are
    the last parts of the tags. Resuming drops all entries after the resumed epoch (0: an empty log), keeps the present
    columns, adds new ones, which are empty in earlier rows, and writes config.yaml and data.json again.
    steps_after: gives the control steps of the whole run at the end of an epoch, from the resumed one on.
    Raises `DataError` if a write fails.
    """

    def __init__(
        self,
        run_dir: Path,
        config: Config,
        data_stamp: Mapping[str, Any],
        reward_terms: Sequence[str],
        steps_after: Callable[[int], int],
        last_epoch: int,
        resumed_epoch: int,
        console: Console | None = None,
    ) -> None:
        self._run_dir, self._csv = run_dir, run_dir / CSV_NAME
        self._steps_after, self._epochs, self._seed = steps_after, last_epoch, config.seed
        self._evaluated = tuple(f"eval/{name}" for name in TASKS[config.env.task].evaluated)
        hold = [HELD] if config.env.hold.first_step is not None else []
        tags = [RETURN, TERMINATED, TRUNCATED, *hold, *(f"reward/{term}" for term in reward_terms)]
        tags += [*(f"ppo/{name}" for name in STATISTICS), STEPS_PER_SECOND, PHYSICS_SHARE, UPDATE_SHARE, LOST_WORKERS]
        columns = [*_FIXED_COLUMNS, *map(_column, [*tags, *self._evaluated])]
        with self._writing():
            rows = _rows_until(self._csv, resumed_epoch) if resumed_epoch else []
            # From now on the run is described by the config and data with which it was begun or resumed.
            write_description(run_dir, config, data_stamp)
            self._forget_incidents(resumed_epoch)
            self._columns = list(dict.fromkeys([*(rows[0] if rows else ()), *columns]))
            self._seconds_before = float(rows[-1]["seconds"]) if rows else 0.0
            self._core_hours_before = float(rows[-1].get("core_hours") or 0.0) if rows else 0.0
            write_atomic(self._csv, _csv_text(self._columns, rows, header=True))
            self._events = EventFile(run_dir, purge_step=resumed_epoch + 1 if resumed_epoch else 0)
            self._events.layout(_layout(reward_terms, self._evaluated, hold))
            self._events.text("config", dump_config(config), resumed_epoch)
            self._events.text("data", json.dumps(data_stamp, indent=2), resumed_epoch)
            for row in rows:
                # These two curves are indexed by cost, not by epoch, but TensorBoard hides earlier points whose index
                # exceeds the resumed epoch. Write them again.
                if row.get(_column(SUCCESS)):
                    cost = int(row["control_steps"]), float(row.get("core_hours") or 0.0)
                    self._success_by_cost(float(row[_column(SUCCESS)]), *cost)
            self._events.flush()
        self._start = time.monotonic()
        self._progress = TrainingProgress(
            steps_after(last_epoch),
            steps_after(resumed_epoch),
            console=console,
            max_seconds=60.0 * (config.ppo.max_minutes or float("inf")),
        )

    def __enter__(self) -> Log:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.close()
        if kind is None:
            with self._writing():
                self._events.close()
        else:
            # The first failure is the one to report.
            with contextlib.suppress(OSError):
                self._events.close()

    def plan(self, environments: int, epochs: int, max_steps: int | None) -> None:
        """Write the run's plan (`write_plan`)."""
        with self._writing():
            write_plan(self._run_dir, environments, epochs, max_steps, self._epochs)

    def step(self, epoch: int, steps: int) -> None:
        """Add control steps to the progress display."""
        self._progress.advance(steps, f"epoch {epoch}/{self._epochs}")

    def evaluation(self) -> contextlib.AbstractContextManager[None]:
        """Context of an evaluation: its time is left out of the display's estimate of the time left."""
        return self._progress.evaluation()

    def evaluating(self, epoch: int, done: int, total: int) -> None:
        """Show the progress of the evaluation after an epoch."""
        self._progress.evaluating(f"epoch {epoch}/{self._epochs}", done, total)

    def message(self, text: str) -> None:
        """Print a line."""
        self._progress.message(text)

    def events(self, epoch: int, events: Sequence[str]) -> None:
        """Log the events that the environments reported, and print the first few."""
        if not events:
            return
        with self._writing():
            self._events.text("events", "\n".join(events), epoch)
        for event in events[:_EVENTS_SHOWN]:
            self.message(f"epoch {epoch}: {event}")
        if len(events) > _EVENTS_SHOWN:
            self.message(f"epoch {epoch}: and {len(events) - _EVENTS_SHOWN} more such events (TensorBoard, text)")

    def incidents(self, incidents: Sequence[Incident], names: Sequence[str]) -> None:
        """List the episodes in which the simulation broke, and save the data needed to replay the first ones.

        incidents.csv has a row for each: epoch, environment, label, step. Each of incidents/*.npz holds seed, epoch,
        environment and actions.
        """
        if not incidents:
            return
        folder, table = self._run_dir / "incidents", self._incidents
        with self._writing():
            folder.mkdir(exist_ok=True)
            rows = "" if table.exists() else "epoch,env,label,step\n"
            for incident in incidents:
                rows += f"{incident.epoch},{incident.env},{names[incident.env]},{len(incident.actions)}\n"
                if len(list(folder.iterdir())) < _INCIDENTS_KEPT:
                    buffer = io.BytesIO()
                    np.savez(
                        buffer, seed=self._seed, epoch=incident.epoch, env=incident.env, actions=incident.actions
                    )
                    name = f"epoch{incident.epoch:06d}_env{incident.env:04d}_step{len(incident.actions):03d}.npz"
                    write_atomic(folder / name, buffer.getvalue())
            with open(table, "a", encoding="utf-8") as stream:
                stream.write(rows)

    @property
    def _incidents(self) -> Path:
        return self._run_dir / "incidents.csv"

    def _forget_incidents(self, epoch: int) -> None:
        """Drop the rows of incidents.csv after the resumed epoch."""
        if self._incidents.is_file():
            header, *rows = self._incidents.read_text(encoding="utf-8").splitlines()
            kept = [row for row in rows if row.split(",")[0].isdecimal() and int(row.split(",")[0]) <= epoch]
            write_atomic(self._incidents, "\n".join([header, *kept]) + "\n")

    def epoch(self, epoch: int, values: Mapping[str, float], gif: bytes | None = None) -> None:
        """Write the values (tag to number) of a completed epoch, and a GIF of its evaluation.

        Epoch 0 is the state before training. Core hours count one core per worker for the whole time, busy or idle.
        """
        steps = self._steps_after(epoch)
        seconds = time.monotonic() - self._start
        core_hours = self._core_hours_before + seconds * values.get(WORKERS, 1.0) / 3600.0
        with self._writing():
            for tag, value in values.items():
                self._events.scalar(tag, value, epoch)
            self._events.scalar("cost/control_steps", steps, epoch)
            self._events.scalar("cost/core_hours", core_hours, epoch)
            if SUCCESS in values:
                self._success_by_cost(values[SUCCESS], steps, core_hours)
            if gif is not None:
                self._add_gif(gif, epoch)
            row = {_column(tag): f"{value:.8g}" for tag, value in values.items()}
            row["epoch"], row["control_steps"] = str(epoch), str(steps)
            row["seconds"], row["core_hours"] = f"{self._seconds_before + seconds:.1f}", f"{core_hours:.5f}"
            with open(self._csv, "a", encoding="utf-8", newline="") as stream:
                stream.write(_csv_text(self._columns, [row], header=False))
            self._events.flush()
        if RETURN in values:
            self._progress.trained(values[RETURN], values.get(HELD))
        if SUCCESS in values:
            self._progress.success(values[SUCCESS])
        if self._evaluated[0] in values:
            known = [tag for tag in (*self._evaluated, RETURN) if tag in values]
            text = ", ".join(f"{_column(tag).replace('_', ' ')} {values[tag]:.3f}" for tag in known)
            self.message(f"epoch {epoch}/{self._epochs}: {text}")

    def _success_by_cost(self, success: float, control_steps: int, core_hours: float) -> None:
        self._events.scalar("cost/success_by_control_steps", success, control_steps)
        self._events.scalar("cost/success_by_core_seconds", success, int(3600 * core_hours))

    def _add_gif(self, gif: bytes, epoch: int) -> None:
        if gif[:4] != b"GIF8":
            raise DataError(f"the evaluation of epoch {epoch} returned a 'gif' that is not a GIF")
        width, height = (int.from_bytes(gif[at : at + 2], "little") for at in (6, 8))
        self._events.image("eval/episode", gif, height, width, epoch)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise DataError(
                f"{self._run_dir}: cannot write the log ({error.strerror or error}); the checkpoints there are "
                "unharmed. Free some space and continue with --resume"
            ) from None


def steps_made(run_dir: Path, epoch: int) -> int | None:
    """The control steps of a run until the end of an epoch, from progress.csv; None if they are not there."""
    rows = _rows_until(run_dir / CSV_NAME, epoch)
    known = rows[-1].get("control_steps", "") if rows and int(rows[-1]["epoch"]) == epoch else ""
    return int(known) if known.isdecimal() else None


def _layout(
    reward_terms: Sequence[str], evaluated: Sequence[str], hold: Sequence[str]
) -> dict[str, dict[str, list[Any]]]:
    """The layout of TensorBoard's custom page: the most important curves first, then all reward terms."""
    contact = [tag for tag in evaluated if tag == CONTACT_RATIO]
    contact += [f"reward/{term}" for term in reward_terms if "contact" in term]
    return {
        "Training": {
            **{_column(tag): ["Multiline", [tag]] for tag in evaluated if tag != CONTACT_RATIO},
            "return": ["Multiline", [RETURN]],
            **{_column(tag): ["Multiline", [tag]] for tag in hold},
            "contact": ["Multiline", contact],
            "KL": ["Multiline", ["ppo/kl"]],
            "steps per second": ["Multiline", [STEPS_PER_SECOND]],
            "success by control steps": ["Multiline", ["cost/success_by_control_steps"]],
        },
        "Reward": {"terms": ["Multiline", [f"reward/{term}" for term in reward_terms]]},
    }


def _rows_until(path: Path, epoch: int) -> list[dict[str, str]]:
    """The rows of a `progress.csv` up to an epoch, without rows that a crash left incomplete."""
    if not path.is_file():
        return []
    lines = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8", errors="replace"), newline="")))
    header = lines[0] if lines else []
    rows = [dict(zip(header, line, strict=True)) for line in lines[1:] if len(line) == len(header)]
    return [row for row in rows if _is_complete(row) and int(row["epoch"]) <= epoch]


def _is_complete(row: Mapping[str, str]) -> bool:
    return row.get("epoch", "").isdecimal() and re.fullmatch(r"\d+\.\d", row.get("seconds", "")) is not None


def _column(tag: str) -> str:
    return tag.rsplit("/", 1)[-1]


def _csv_text(columns: Sequence[str], rows: Sequence[Mapping[str, str]], header: bool) -> str:
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, columns, restval="", extrasaction="ignore", lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()
