"""Fill a table: evaluate the trained policies and keep the results."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.config.experiment import Config, find_config, load_config
from dgrasp.config.sections import INERTIA
from dgrasp.config.values import flat_keys
from dgrasp.data import DataChoice, find_root
from dgrasp.errors import DataError, DGraspError
from dgrasp.eval.motion import usual_set
from dgrasp.eval.summary import Result, Row, is_metric, summarise
from dgrasp.evaluation import evaluate_choice, evaluate_motion
from dgrasp.files.atomic import write_atomic
from dgrasp.files.paths import cfg_root
from dgrasp.files.typed import typed
from dgrasp.labels.load import sha256_of
from dgrasp.methods import PolicyMethod
from dgrasp.request import Asked, Request, make_request
from dgrasp.tables.plan import Line, Plan, Trial
from dgrasp.tables.trainings import Say, Trainings

_OF_TEST = ("labels.", "physics.", "eval.window_s", "env.grasp_steps")
_NOT_OF_TEST = ("labels.per_epoch", "labels.doubles_every", "motion.policy", "motion.targets")
"""Prefixes of the keys that define an evaluation, and those among them that the training or the table chooses."""


@dataclass
class Cells:
    """A filled row.

    values: metric -> mean over objects. With several seeds, each label is averaged over the seeds first.
    intervals: metric -> [low, high].
    n: number of labels (or motions).
    comparable: whether hand, labels, targets and the keys of the evaluation are the paper's.
    differences: why not, as far as the results tell.
    evaluated: engine, window, inertia and commit of the evaluations.
    missing: why values are missing. errors: those of the reasons that no training would mend.
    notes: remarks on the values.
    commands: the command lines of the evaluations.
    seeds: seed -> its own values; empty with a single seed.
    """

    line: Line
    values: dict[str, float] = field(default_factory=dict)
    intervals: dict[str, list[float]] = field(default_factory=dict)
    n: int = 0
    comparable: bool = False
    differences: list[str] = field(default_factory=list)
    evaluated: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)
    seeds: dict[int, dict[str, float]] = field(default_factory=dict)


@dataclass
class Found:
    """One seed's part of a table row.

    rows: the labels' rows. results: their evaluations. missing, errors, notes, commands: as in `Cells`.
    changed: keys, with their values, in which the evaluations differ from those that the table row asks for.
    places: for each of `rows`, the index of its evaluation in the table row.
    """

    seed: int
    rows: list[Row] = field(default_factory=list)
    results: list[dict[str, Any]] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)
    changed: list[str] = field(default_factory=list)
    places: list[int] = field(default_factory=list)

    @property
    def tagged(self) -> list[tuple[int, Row]]:
        """The labels' rows, each with the index of its evaluation in the table row."""
        return list(zip(self.places, self.rows, strict=True))


class Tables:
    """Training runs and results of one recipe, engine and seed below `root`.

    cfg: the recipe that policies are trained with. overrides: keys for training and evaluation, such as data, engine
    and seed. policy: a checkpoint that replaces the policy of all objects, such as one that the authors published.
    """

    def __init__(
        self, root: Path, cfg: Path | None, overrides: Sequence[str], policy: Path | None = None,
        say: Say = print,
    ) -> None:  # fmt: skip
        self.cfg = cfg or Path("cfg/dexycb.yaml")
        self.overrides, self.say = list(overrides), say
        config = load_config(find_config(self.cfg), self.overrides)
        # Without data every row would only repeat this error, or name a training that fails with it.
        find_root(config)
        folder = root / f"{config.name}_{config.engine}_seed{config.seed}"
        self.seed, self.results = config.seed, folder / "results"
        self.trainings = Trainings(folder, self.cfg, self.overrides, policy, say)

    def find(self, line: Line, motion: bool) -> Found:
        """The evaluations of a row whose policies are trained, and the reasons why others are missing."""
        found = Found(self.seed)
        for place, trial in enumerate(line.trials):
            try:
                missing = None if trial.run is None else self.trainings.missing(trial.run)
                if missing is not None:
                    found.missing.append(missing)
                    continue
                result, command, changed = self._evaluate(trial, motion)
            except DGraspError as error:
                found.errors.append(f"{line.group}, {line.name}: {error}")
                found.missing.append(found.errors[-1])
                continue
            found.commands.append(command)
            found.changed += [key for key in changed if key not in found.changed]
            found.rows += result["per_label"]
            found.places += [place] * len(result["per_label"])
            found.results.append(result)
            if trial.run is not None:
                found.notes += self.trainings.about(trial.run)
        if found.results and len(found.results) < len(line.trials):
            found.notes.append(f"{line.group}, {line.name}: only {len(found.results)} of {len(line.trials)} "
                               "evaluations are available")
        if found.changed:
            found.notes.append(f"evaluated with {', '.join(found.changed)}, which differs from this table's rows")
        return found

    def _evaluate(self, trial: Trial, motion: bool) -> tuple[Any, str, list[str]]:
        request, command = self._request(trial, motion)
        config, choice = request.config, request.choice
        changed = _changed(trial, config, motion)
        file = self.results / f"{self._key(trial, config, choice)}.json"
        if file.is_file():
            try:
                return json.loads(file.read_text(encoding="utf-8")), command, changed
            except ValueError:
                self.say(f"{file} is damaged; evaluating again")
        self.say(f"evaluating: {command}")
        evaluation = evaluate_motion if motion else evaluate_choice
        result, _, _ = evaluation(request.method, config, choice)
        try:
            self.results.mkdir(parents=True, exist_ok=True)
            write_atomic(file, json.dumps(result.as_dict(), allow_nan=False))
        except OSError as error:
            raise DataError(f"{file}: cannot write the result ({error.strerror or error}); choose another folder with "
                            "--runs") from None
        return result.as_dict(), command, changed

    def _request(self, trial: Trial, motion: bool) -> tuple[Request, str]:
        """A trial's evaluation, and the command line that runs the same evaluation."""
        run, overrides = trial.run, [*self.overrides, *trial.overrides]
        asked = Asked(cfg=self.cfg) if run is None else self.trainings.asked(run)
        if run is not None:
            overrides += self.trainings.own_grasp(run)
        baseline = None if trial.method == PolicyMethod.name else trial.method
        asked = replace(asked, baseline=baseline, overrides=overrides)
        request = make_request(asked)
        if motion:
            asked = replace(asked, values={"motion.targets": usual_set(request.choice)})
            request = make_request(asked)
        return request, _command(asked)

    def _key(self, trial: Trial, config: Config, choice: DataChoice) -> str:
        """File name of an evaluation: a hash of everything that its numbers depend on."""
        weights = "" if trial.run is None else sha256_of(self.trainings.policy_of(trial.run))
        used = config.model_dump(mode="json", exclude={"pool", "ppo", "checkpoint", "device", "name"})
        text = json.dumps([trial.method, weights, used, choice.stamp()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]


def _command(asked: Asked) -> str:
    """The command line for what is asked."""
    paths = {"--cfg": asked.cfg, "--policy": asked.policy, "--run": asked.run, "--baseline": asked.baseline}
    words = [word for name, value in paths.items() if value is not None for word in (name, str(value))]
    words += asked.overrides
    if "motion.targets" in asked.values:
        words += ["--motion", asked.values["motion.targets"]]
    return typed("test", words)


def fill(plan: Plan, seeds: Sequence[Tables]) -> list[Cells]:
    """The rows of a table over all seeds. Rows without training are evaluated with the first seed only."""
    rows = []
    for line in plan.lines:
        learned = any(trial.run is not None for trial in line.trials)
        rows.append(_row(line, [one.find(line, plan.name == "motion") for one in (seeds if learned else seeds[:1])]))
    return rows


def _row(line: Line, seeds: Sequence[Found]) -> Cells:
    cells = Cells(line)
    for one in seeds:
        cells.missing += one.missing
        cells.errors += one.errors
        cells.notes += one.notes
        cells.commands += one.commands
    there = [one for one in seeds if one.rows]
    if not there:
        return cells
    rows, results = _over_seeds([one.tagged for one in there]), [result for one in there for result in one.results]
    whole = _summary(rows, there[0].results[0])
    cells.values, cells.n = dict(whole.mean_over_objects), len(rows)
    cells.intervals = dict(whole.intervals["mean_over_objects"])
    cells.comparable = all(map(_comparable, results)) and not any(one.changed for one in there)
    cells.differences = list(dict.fromkeys(why for one in results for why in one["data"].get("not_comparable", [])))
    cells.evaluated = list(dict.fromkeys(
        ", ".join(filter(None, [result["engine"], f"window {result['window_s']:g} s",
                                INERTIA.get(result["data"].get("inertia")), f"version {result['commit'][:7]}"]))
        for result in results
    ))  # fmt: skip
    if len(seeds) > 1:
        cells.seeds = {one.seed: dict(_summary(one.rows, one.results[0]).mean_over_objects) for one in there}
    return cells


def _over_seeds(seeds: Sequence[Sequence[tuple[int, Row]]]) -> list[Row]:
    """One row for each label (or motion) with its means over the seeds that have it.

    seeds: per seed, (index of the evaluation, row). An interval over labels must count each label once, because further
    seeds add no further labels.
    """
    if len(seeds) == 1:
        return [row for _, row in seeds[0]]
    same: dict[tuple[Any, ...], list[Row]] = {}
    for tagged in seeds:
        counted: dict[tuple[Any, ...], int] = {}
        for place, row in tagged:
            label = place, row["object"], row["index"]
            counted[label] = counted.get(label, 0) + 1
            same.setdefault((*label, counted[label]), []).append(row)
    return [{"object": name, "index": index, **_mean(rows)} for (_, name, index, _), rows in same.items()]


def _mean(rows: Sequence[Row]) -> Row:
    names = dict.fromkeys(name for row in rows for name in row if is_metric(name, row[name]))
    return {name: float(np.mean([row[name] for row in rows if name in row])) for name in names}


def _changed(trial: Trial, config: Config, motion: bool) -> list[str]:
    """The keys, with their values, in which an evaluation differs from the one that its row asks for."""
    file = None if trial.run is None or trial.run.cfg is None else Path(trial.run.cfg)
    words = ["physics.preset=faithful", *trial.overrides]
    asked = load_config(cfg_root() / (file or Path("dexycb.yaml")).name, words)
    there, here = (flat_keys(one.model_dump(mode="json")) for one in (asked, config))
    counted = (*_OF_TEST, "motion.") if motion else _OF_TEST
    return [f"{key}={here[key]}" for key in here
            if key.startswith(counted) and key not in _NOT_OF_TEST and here[key] != there.get(key)]


def _comparable(result: Mapping[str, Any]) -> bool:
    """Whether an evaluation uses the paper's hand and labels and, if it moves objects, the paper's targets."""
    motion = result.get("motion")
    return bool(result["data"].get("comparable_with_paper")) and (motion is None or motion["targets"] == "easy")


def _summary(rows: list[Row], like: Mapping[str, Any]) -> Result:
    """The summary of labels' rows; method, engine, data and the like are those of the result `like`."""
    return summarise(
        rows, method=like["method"], engine=like["engine"], window_s=like["window_s"], seed=like["seed"],
        data=like["data"], cost=like["cost"], motion=like.get("motion"),
    )  # fmt: skip
