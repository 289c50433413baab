"""Fill a table: train what is missing if there is a budget, evaluate what is trained, keep what was evaluated."""

from __future__ import annotations

import argparse
import hashlib
import json
import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dgrasp import test, train
from dgrasp.atomic import write_atomic
from dgrasp.config import Config, load_config
from dgrasp.data import DataChoice, resolve
from dgrasp.errors import DataError, DGraspError
from dgrasp.eval.motion import usual_set
from dgrasp.eval.summary import Result, Row, summarise
from dgrasp.request import config_of, method_for
from dgrasp.rl import checkpoint
from dgrasp.runs import read_run
from dgrasp.tables.plan import ALL_OBJECTS, Line, Plan, Trained, Trial

Say = Callable[[str], None]
_OF_TRAINING = ("env", "ppo", "labels.per_epoch", "physics.preset", "physics.official_compat", "physics.masses")
"""Keys that make a training another than the paper's."""


@dataclass
class Cells:
    """A filled row. values: metric -> mean over objects; intervals: metric -> [low, high]; n: labels (or motions).

    missing: why there are no values. notes: what a reader must know of them. comparable: hand and labels are the
    paper's. commands: what evaluates it by hand. seeds: with several, seed -> its own values; then `values` are means
    over all seeds, and n counts a label once for each.
    """

    line: Line
    values: dict[str, float] = field(default_factory=dict)
    intervals: dict[str, list[float]] = field(default_factory=dict)
    n: int = 0
    comparable: bool = False
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)
    seeds: dict[int, dict[str, float]] = field(default_factory=dict)


@dataclass
class Found:
    """What one seed has of a row: its labels' rows, the evaluations that they are from, and as in `Cells`."""

    seed: int
    rows: list[Row] = field(default_factory=list)
    results: list[dict[str, Any]] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)


class Tables:
    """Runs and results of one recipe, engine and seed below `root`.

    cfg: the recipe that policies are trained with. overrides: keys for trainings and evaluations alike, such as data,
    engine and seed. policy: a checkpoint that stands in for the policy of all objects, such as one that the authors
    published.
    """

    def __init__(
        self, root: Path, cfg: Path | None, overrides: Sequence[str], policy: Path | None = None,
        say: Say = print,
    ) -> None:  # fmt: skip
        self.cfg = cfg or Path("cfg/dexycb.yaml")
        self.overrides, self.policy, self.say = list(overrides), policy, say
        config = self._config([])
        self.seed = config.seed
        self.root = root / f"{config.name}_{config.engine}_seed{config.seed}"
        self.results = root / "results"

    def _config(self, overrides: Sequence[str]) -> Config:
        return load_config(train.find_config(self.cfg), [*self.overrides, *overrides])

    # Trainings ---------------------------------------------------------------------------------

    def run_dir(self, run: Trained) -> Path:
        """Where a training is, or will be."""
        return self.root / run.key

    def train_words(self, run: Trained) -> list[str]:
        """Arguments of train.py."""
        words = ["--cfg", str(run.cfg or self.cfg), "--run", str(self.run_dir(run)), *self.overrides, *run.overrides]
        if run.policy is not None:
            words.append(f"motion.policy={json.dumps(str(self._policy_of(run.policy)))}")
        return words

    def _policy_of(self, run: Trained) -> Path:
        if run == ALL_OBJECTS and self.policy is not None:
            return self.policy
        return checkpoint.latest(self.run_dir(run))

    def _is_trained(self, run: Trained) -> bool:
        if run == ALL_OBJECTS and self.policy is not None:
            return True
        return bool(checkpoint.saved(self.run_dir(run)))

    def _needs(self, run: Trained) -> str | None:
        """What is left to do for a run: "train", "resume", or nothing."""
        if run == ALL_OBJECTS and self.policy is not None:
            return None
        folder = self.run_dir(run)
        if not (folder / "config.yaml").is_file():
            return "train"
        made = read_run(folder)
        # One that ended with its share of an earlier budget goes on.
        return "resume" if made.state != "running" and not made.complete else None

    def train_missing(self, plans: Sequence[Plan], budget_min: float) -> None:
        """Train what the tables lack in so many minutes, each run with an equal share of what is left of them."""
        todo = [run for run in needed(plans) if self._needs(run) is not None]
        end = time.monotonic() + 60.0 * budget_min
        for i, run in enumerate(todo):
            share = max((end - time.monotonic()) / 60.0 / (len(todo) - i), 0.01)
            if run.policy is not None and not self._is_trained(run.policy):
                continue
            resume = self._needs(run) == "resume"
            words = ["--resume", str(self.run_dir(run))] if resume else self.train_words(run)
            self.say(f"training {i + 1} of {len(todo)}: {run.key}, {share:.1f} minutes")
            try:
                train.main(_parse(train, [*words, f"ppo.max_minutes={share:.4f}"]))
            except DataError as error:
                # One table's data may lack what another's has.
                self.say(f"{run.key}: {error}")

    # Evaluations -------------------------------------------------------------------------------

    def find(self, line: Line, motion: bool) -> Found:
        """The evaluations of a row, as far as its policies are trained."""
        found = Found(self.seed)
        for trial in line.trials:
            if trial.run is not None and not self._is_trained(trial.run):
                found.missing.append(self._how_to_train(trial.run))
                continue
            try:
                result, command = self._evaluate(trial, motion)
            except DGraspError as error:
                found.missing.append(f"{line.group}, {line.name}: {error}")
                continue
            found.commands.append(command)
            found.rows += result["per_label"]
            found.results.append(result)
            if trial.run is not None:
                found.notes += self._about(trial.run)
        if found.results and len(found.results) < len(line.trials):
            found.notes.append(f"{line.group}, {line.name}: {len(found.results)} of {len(line.trials)} evaluations are "
                               "there")
        return found

    def _how_to_train(self, run: Trained) -> str:
        if run.policy is not None and not self._is_trained(run.policy):
            return f"{self._how_to_train(run.policy)} and then train {run.key}"
        return shlex.join(["python", "train.py", *self.train_words(run)])

    def _about(self, run: Trained) -> list[str]:
        """What differs from the paper's training, and whether this one came to its end."""
        if run == ALL_OBJECTS and self.policy is not None:
            return [f"the policy of all objects is {self.policy.name}"]
        read = read_run(self.run_dir(run))
        paper, here = _flat(Config()), _flat(read.config)
        changed = [f"{key}={here[key]}" for key in here
                   if key.startswith(_OF_TRAINING) and here[key] != paper[key] and not key.startswith("ppo.max_")]
        made = f"{read.number('control_steps'):,.0f} control steps, {read.number('core_hours'):.2f} core-hours"
        end = "" if read.complete else f" of {read.epochs}"
        return [f"{run.key}: {read.number('epoch'):.0f}{end} epochs, {made}"
                + (f"; differs from the paper's training in {', '.join(changed)}" if changed else "")]

    def _evaluate(self, trial: Trial, motion: bool) -> tuple[Any, str]:
        words: list[str] = []
        if trial.run is not None:
            use_policy = trial.run == ALL_OBJECTS and self.policy is not None
            words += ["--policy", str(self.policy)] if use_policy else ["--run", str(self.run_dir(trial.run))]
        if trial.method != "policy":
            words += ["--baseline", trial.method]
        if trial.run is None:
            words += ["--cfg", str(self.cfg)]
        words += [*self.overrides, *trial.overrides]
        arguments = _parse(test, words)
        config = config_of(arguments)
        choice = resolve(config)
        if motion:
            words += ["--motion", usual_set(choice)]
            config = config_of(_parse(test, words))
        command = shlex.join(["python", "test.py", *words])
        file = self.results / f"{self._key(trial, config, choice)}.json"
        if file.is_file():
            try:
                return json.loads(file.read_text(encoding="utf-8")), command
            except ValueError:
                self.say(f"{file} is damaged and is made again")
        self.say(f"evaluating: {command}")
        evaluation = test.evaluate_motion if motion else test.evaluate_choice
        result, _, _ = evaluation(method_for(arguments), config, choice)
        self.results.mkdir(parents=True, exist_ok=True)
        write_atomic(file, json.dumps(result.as_dict(), allow_nan=False))
        return result.as_dict(), command

    def _key(self, trial: Trial, config: Config, choice: DataChoice) -> str:
        """Names an evaluation by all that its figures depend on."""
        weights = "" if trial.run is None else hashlib.sha256(self._policy_of(trial.run).read_bytes()).hexdigest()
        used = config.model_dump(mode="json", exclude={"pool", "ppo", "checkpoint", "device", "name"})
        text = json.dumps([trial.method, weights, used, choice.stamp()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]


def fill(plan: Plan, seeds: Sequence[Tables]) -> list[Cells]:
    """The rows of a table, over the seeds; what needs no training is the same for all and taken from the first."""
    rows = []
    for line in plan.lines:
        learned = any(trial.run is not None for trial in line.trials)
        rows.append(_row(line, [one.find(line, plan.name == "motion") for one in (seeds if learned else seeds[:1])]))
    return rows


def _row(line: Line, seeds: Sequence[Found]) -> Cells:
    cells = Cells(line)
    for one in seeds:
        cells.missing += one.missing
        cells.notes += one.notes
        cells.commands += one.commands
    there = [one for one in seeds if one.rows]
    if not there:
        return cells
    whole = _summary([row for one in there for row in one.rows], there[0].results[0])
    cells.values, cells.n = dict(whole.mean_over_objects), sum(len(one.rows) for one in there)
    cells.intervals = dict(whole.intervals["mean_over_objects"])
    cells.comparable = all(r["data"].get("comparable_with_paper") for one in there for r in one.results)
    if len(seeds) > 1:
        cells.seeds = {one.seed: dict(_summary(one.rows, one.results[0]).mean_over_objects) for one in there}
    return cells


def _summary(rows: list[Row], like: Mapping[str, Any]) -> Result:
    """The summary of labels' rows that were evaluated like that."""
    return summarise(
        rows, method=like["method"], engine=like["engine"], window_s=like["window_s"], seed=like["seed"],
        data=like["data"], cost=like["cost"], motion=like.get("motion"),
    )  # fmt: skip


def needed(plans: Sequence[Plan]) -> list[Trained]:
    """The trainings that tables take, each once, those that others build on first."""
    found: dict[Trained, None] = {}
    for plan in plans:
        for line in plan.lines:
            for trial in line.trials:
                if trial.run is not None:
                    if trial.run.policy is not None:
                        found.setdefault(trial.run.policy)
                    found.setdefault(trial.run)
    return list(found)


def _parse(command: Any, words: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_intermixed_args(list(words))


def _flat(config: Config) -> dict[str, Any]:
    def walk(values: dict[str, Any], prefix: str) -> dict[str, Any]:
        flat: dict[str, Any] = {}
        for key, value in values.items():
            flat |= walk(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
        return flat

    return walk(config.model_dump(mode="json"), "")
