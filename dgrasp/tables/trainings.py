"""The training runs that tables need: find them, check their data and settings, and train missing ones in a budget."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dgrasp.build import frozen_policy
from dgrasp.config.experiment import Config, find_config, load_config
from dgrasp.config.values import flat_keys, override
from dgrasp.data import resolve
from dgrasp.errors import DataError, DGraspError
from dgrasp.files.atomic import write_atomic
from dgrasp.files.paths import cfg_root
from dgrasp.files.typed import typed
from dgrasp.request import Asked
from dgrasp.rl.run.folder import latest, saved
from dgrasp.rl.run.record import Run, read_run
from dgrasp.tables.plan import ALL_OBJECTS, FAST, Plan, Trained, plans
from dgrasp.training import begin, resume, start_run, train

Say = Callable[[str], None]
_OF_TRAINING = ("env.", "ppo.", "labels.", "physics.", "motion.sigma_")
"""Prefixes of the keys in which a training run must agree with its row."""
_LENGTH = ("epochs", "max_steps")
"""Keys of `ppo` that set the length of a training. The command's values apply, not those that the run began with."""
_OF_DATA = ("kind", "hand_sha256", "labels_sha256")
"""Entries of a data stamp that identify the data. Another split, choice of objects or licence text does not matter."""
_GRASP = "grasp"
"""File name, without suffix, of a run's own copy of the policy that it builds on; the suffix is that policy's."""


class Trainings:
    """The training runs of one recipe, engine and seed in the folder `root`.

    cfg: the recipe of runs that name no config file. overrides: keys for all runs. policy: a file that replaces the
    policy of all objects. say: called with each line of output.
    """

    def __init__(self, root: Path, cfg: Path, overrides: Sequence[str], policy: Path | None, say: Say) -> None:
        self.root, self.cfg, self.overrides = root, cfg, list(overrides)
        self.policy, self.say = policy, say
        self._stamps: dict[Trained, dict[str, Any]] = {}

    def run_dir(self, run: Trained) -> Path:
        """The folder of a run, which need not exist yet."""
        return self.root / run.key

    def command(self, run: Trained) -> str:
        """The command line that trains a run."""
        words = ["--cfg", str(run.cfg or self.cfg), "--run", str(self.run_dir(run)), *self.overrides, *run.overrides]
        if run.policy is not None:
            words.append(_motion_policy(self.policy_of(run.policy)))
        return typed("train", words)

    def asked(self, run: Trained) -> Asked:
        """The part of an evaluation's request that names the run's policy."""
        return Asked(policy=self.policy) if self.stands_in(run) else Asked(run=self.run_dir(run))

    def policy_of(self, run: Trained) -> Path:
        """The current file of a run's policy; raises `DataError` if there is none."""
        if self.stands_in(run) and self.policy is not None:
            return self.policy
        return latest(self.run_dir(run))

    def stands_in(self, run: Trained) -> bool:
        """Whether the file `policy` replaces a run."""
        return run == ALL_OBJECTS and self.policy is not None

    def missing(self, run: Trained) -> str | None:
        """Why a run's policy cannot be evaluated, or the command that trains it; None if it can be evaluated."""
        if self.stands_in(run):
            return None
        other = self._other_data(run)
        if other is not None:
            return other
        if saved(self.run_dir(run)):
            return None
        before = None if run.policy is None else self.missing(run.policy)
        if before is not None:
            return f"{before} and then train {run.key}"
        if (self.run_dir(run) / "config.yaml").is_file():
            if read_run(self.run_dir(run)).state == "running":
                return f"{self.run_dir(run)} is being trained and has no checkpoint yet"
            return typed("train", ["--resume", self.run_dir(run)])
        return self.command(run)

    def about(self, run: Trained) -> list[str]:
        """One line: the progress of a run, and its differences from the training that its row asks for."""
        if self.policy is not None and self.stands_in(run):
            return [f"the policy of all objects is {self.policy.name}"]
        # The evaluation uses the last checkpoint; the log may be ahead of it.
        made = self._as_long(run, read_run(self.run_dir(run)))
        if there_are := saved(self.run_dir(run)):
            made = made.until(int(there_are[-1].stem))
        # The paper's training is the default of every key, except for baselines, which have their own config files.
        asked = load_config(None if run.cfg is None else cfg_root() / Path(run.cfg).name, list(run.overrides))
        told = load_config(find_config(Path(run.cfg or self.cfg)), [*self.overrides, *run.overrides])
        there, here, now = (_with_inertia(config, made.data) for config in (asked, made.config, told))
        counted = [key for key in here if key.startswith(_OF_TRAINING) and not key.startswith("ppo.max_")]
        changed = [f"{key}={here[key]}" for key in counted if here[key] != there[key]]
        stale = [f"{key}={here[key]}" for key in counted
                 if here[key] != now[key] and key not in [f"ppo.{name}" for name in _LENGTH]]
        cost = f"{made.number('control_steps'):,.0f} control steps, {made.number('core_hours'):.2f} core-hours"
        end = "" if made.complete else f" of {made.epochs}"
        whose = FAST if run.cfg == FAST else "the paper's training"
        return [f"{run.key}: {made.number('epoch'):.0f}{end} epochs, {cost}"
                + (f"; differs from {whose} in {', '.join(changed)}" if changed else "")
                + (f"; differs from this command: it was trained with {', '.join(stale)}" if stale else "")]

    def own_grasp(self, run: Trained) -> list[str]:
        """The override that names a run's own copy of the policy that it builds on; [] if it builds on none.

        If train.py was given another file, the copy is made now, because the run of that file deletes old checkpoints.
        """
        folder = self.run_dir(run)
        if run.policy is None or not saved(folder):
            return []
        copies = sorted(folder.glob(f"{_GRASP}.*"))
        named = Path(os.path.expanduser(str(read_run(folder).config.motion.policy)))
        if not copies and not named.is_file():
            return []
        return [_motion_policy(copies[0] if copies else _copy(named, folder))]

    def train_missing(self, chosen: Sequence[Plan], budget_min: float) -> None:
        """Train the runs that the tables need and lack within `budget_min` minutes.

        Each run gets an equal share of the time that is left.
        """
        for run in needed(plans("all")):
            with contextlib.suppress(DGraspError):  # the run's own row reports the error
                self.own_grasp(run)
        todo = [run for run in needed(chosen) if self._needs(run) is not None]
        end = time.monotonic() + 60.0 * budget_min
        for i, run in enumerate(todo):
            minutes = max((end - time.monotonic()) / 60.0 / (len(todo) - i), 0.01)
            limit = f"ppo.max_minutes={minutes:.4f}"
            try:
                begins = self._needs(run) == "train"
                if begins and run.policy is not None and self.missing(run.policy) is not None:
                    continue
                self.say(f"training {i + 1} of {len(todo)}: {run.key}, {minutes:.1f} minutes")
                if begins and run.policy is not None:
                    self._train_with_own_grasp(run, self.policy_of(run.policy), limit)
                elif begins:
                    begin(self._config(run, limit), self.run_dir(run))
                else:
                    length = [override(f"ppo.{name}", value) for name, value in self._length(run).items()]
                    resume(self.run_dir(run), [*self.own_grasp(run), *length, limit])
            except DGraspError as error:
                # One run's error must not stop the others: its data may be missing, or it may refuse another recipe's
                # policy.
                self.say(f"{run.key}: {error}")

    def _needs(self, run: Trained) -> str | None:
        """What is left to do for a run: "train", "resume" or None."""
        if self.stands_in(run):
            return None
        folder = self.run_dir(run)
        if not (folder / "config.yaml").is_file():
            return "train"
        made = self._as_long(run, read_run(folder))
        # A run that used up its share of an earlier budget is resumed.
        if made.state == "running" or made.complete or self._other_data(run) is not None:
            return None
        # A run on another run's policy that has no checkpoint yet starts again, with the current policy.
        return "train" if run.policy is not None and not saved(folder) else "resume"

    def _train_with_own_grasp(self, run: Trained, policy: Path, limit: str) -> None:
        """Train a run with a copy, in its folder, of the policy that it builds on."""
        folder = self.run_dir(run)
        frozen_policy(self._config(run, _motion_policy(policy)))
        choice = resolve(self._config(run))
        print(choice.describe(), flush=True)
        config = self._config(run, _motion_policy(_copy(policy, folder)), limit)
        start_run(folder, config, choice)
        train(folder, config, choice)

    def _config(self, run: Trained, *more: str) -> Config:
        """The config that this command trains a run with."""
        return load_config(find_config(Path(run.cfg or self.cfg)), [*self.overrides, *run.overrides, *more])

    def _length(self, run: Trained) -> dict[str, Any]:
        """The length of a run's training according to this command: key of `ppo` -> value."""
        ppo = self._config(run).ppo
        return {name: getattr(ppo, name) for name in _LENGTH}

    def _as_long(self, run: Trained, made: Run) -> Run:
        """The run with the length of training that this command sets."""
        ppo = made.config.ppo.model_copy(update=self._length(run))
        return replace(made, config=made.config.model_copy(update={"ppo": ppo}))

    def _other_data(self, run: Trained) -> str | None:
        """Why a run was not trained on the tables' data; None if it was, or if the run does not exist."""
        folder = self.run_dir(run)
        if not (folder / "config.yaml").is_file():
            return None
        there = read_run(folder).data
        try:
            if run not in self._stamps:
                self._stamps[run] = resolve(self._config(run)).stamp()
        except DataError as error:
            return f"{folder}: cannot tell whether it was trained on this data ({error})"
        here = self._stamps[run]
        differs = [key for key in _OF_DATA if there.get(key) != here[key]]
        if not differs:
            return None
        return (f"{folder} was trained on other data ({there.get('kind', 'unknown')}, here {here['kind']}; data.json "
                f"differs in {', '.join(differs)}), so it is neither evaluated nor resumed; give that data with "
                "--data, or another folder for runs on this data with --runs")


def needed(chosen: Sequence[Plan]) -> list[Trained]:
    """The training runs that tables need, each once; runs that others build on come first."""
    found: dict[Trained, None] = {}
    for plan in chosen:
        for line in plan.lines:
            for trial in line.trials:
                if trial.run is not None:
                    if trial.run.policy is not None:
                        found.setdefault(trial.run.policy)
                    found.setdefault(trial.run)
    return list(found)


def _with_inertia(config: Config, data: dict[str, Any]) -> dict[str, Any]:
    """The flat keys of a config, with `official_compat` as it applies to the data in place of null."""
    authors = config.physics.authors_inertia(data.get("kind") == "release")
    return flat_keys(config.model_dump(mode="json")) | {"physics.official_compat": authors}


def _motion_policy(file: Path) -> str:
    return override("motion.policy", str(file))


def _copy(policy: Path, folder: Path) -> Path:
    copy = folder / f"{_GRASP}{policy.suffix}"
    try:
        content = policy.read_bytes()
    except OSError as error:
        raise DataError(f"{policy}: cannot read the policy ({error.strerror or error})") from None
    write_atomic(copy, content)
    return copy
