"""The training run: collect, update, evaluate, log, save. Interrupting and resuming does not change the result."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dgrasp.config.experiment import Config
from dgrasp.config.values import flat_keys
from dgrasp.errors import ConfigError, DGraspError
from dgrasp.rl.networks import ActorCritic, Policy
from dgrasp.rl.ppo import Ppo
from dgrasp.rl.run import checkpoint as checkpoints
from dgrasp.rl.run.checkpoint import Checkpoint
from dgrasp.rl.run.interrupts import Interrupted, Preempted, interruptible, uninterruptible
from dgrasp.rl.run.lock import only_run
from dgrasp.rl.run.log import (
    HELD,
    RETURN,
    STEPS_PER_SECOND,
    SUCCESS,
    TERMINATED,
    TRUNCATED,
    UPDATE_SHARE,
    Log,
    steps_made,
)
from dgrasp.rl.storage import Rollout
from dgrasp.rl.vec_env import VecEnv
from dgrasp.version import __version__

_SHARES = (10, 25, 50, 75)
"""Per cent of a training shorter than `eval.every` after which it is evaluated too."""
Evaluate = Callable[[Policy], dict[str, Any]]
"""Evaluates a policy deterministically. Returns numbers by name, such as "success", and bytes under "gif" if any."""


def epoch_generator(seed: int, epoch: int) -> torch.Generator:
    """The learner's CPU generator for an epoch. Epoch 0 initialises the networks."""
    # The spawn key separates this stream from others derived from the same two numbers.
    sequence = np.random.SeedSequence([seed, epoch], spawn_key=(1,))
    return torch.Generator().manual_seed(int(sequence.generate_state(1, np.uint64)[0]))


@contextlib.contextmanager
def _threads(number: int) -> Iterator[None]:
    """Use this many torch threads inside the block and restore the previous number afterwards."""
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def pick_device(name: str) -> torch.device:
    """The torch device for the config's `device`; `auto` takes a GPU if there is one."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("device: cuda is not available here; expected auto or cpu")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


class Runner:
    """Trains a policy in `env` and maintains the run directory.

    data_stamp: identifies the training data, as plain JSON values. evaluate: called before the first epoch, every
    `eval.every` epochs and at the end. resume: continue from the newest checkpoint of `run_dir`; the result is equal,
    to the bit, to that of a run without the interruption. Raises `ConfigError` for a directory that holds another
    run, `DataError` for a checkpoint that cannot be resumed.
    """

    def __init__(
        self,
        env: VecEnv,
        config: Config,
        run_dir: Path,
        data_stamp: dict[str, Any],
        evaluate: Evaluate | None = None,
        resume: bool = False,
    ) -> None:
        self.env, self.config, self.run_dir, self.evaluate = env, config, run_dir, evaluate
        self.data_stamp = json.loads(json.dumps(data_stamp))
        ppo = config.ppo
        if self._steps_in(1) < ppo.minibatches:
            raise ConfigError(
                f"ppo.minibatches: {ppo.minibatches} are more than the {self._steps_in(1)} samples of an epoch"
            )
        self.device = pick_device(config.device)
        self.model = ActorCritic(
            env.observation_size, env.action_size, ppo.hidden, ppo.initial_std, epoch_generator(config.seed, 0),
            env.actor_size, ppo.output_gain,
        ).to(self.device)
        self.ppo = Ppo(self.model, ppo)
        self.rollout = Rollout(self.device)
        self.epoch = self._resumed_epoch = self._resumed_steps = 0
        self.best_success: float | None = None
        self._notices: list[str] = []
        self._lost_steps = 0
        self._log: Log | None = None
        if resume:
            self._restore()
        elif checkpoints.saved(run_dir):
            raise ConfigError(f"{run_dir} already holds checkpoints; continue with --resume or choose another --run")
        self._completed = self._snapshot()

    def learn(self) -> None:
        """Train to the last epoch; `Interrupted` on Ctrl-C or SIGTERM, with the last completed epoch saved."""
        with interruptible(), only_run(self.run_dir):
            try:
                with self._open_log() as log:
                    self._log = log
                    self._learn(log)
            except DGraspError:
                # After a fatal error, such as a lost pool or a gradient that is not finite, keep the last good epoch.
                if self._completed.epoch > self._resumed_epoch:
                    with uninterruptible(), contextlib.suppress(DGraspError):
                        self._save()
                raise
            except KeyboardInterrupt as stop:
                with uninterruptible():
                    path = self._save()
                raise Interrupted(path, self._completed.epoch, isinstance(stop, Preempted)) from None

    def _learn(self, log: Log) -> None:
        for notice in self._notices:
            log.message(notice)
        last_epoch = self.last_epoch
        deadline = time.monotonic() + 60.0 * (self.config.ppo.max_minutes or float("inf"))
        if self.epoch == 0:
            self._complete(0, {}, log)
        elif self.epoch >= last_epoch:
            log.message(f"epoch {self.epoch} of {last_epoch} is reached; raise ppo.epochs or ppo.max_steps to train on")
        for epoch in range(self.epoch + 1, last_epoch + 1):
            generator = epoch_generator(self.config.seed, epoch)
            started = time.monotonic()
            lost = self._lost_steps
            rewards = self._collect(epoch, log)
            collected = time.monotonic()
            with _threads(self.config.ppo.threads):
                statistics = self.ppo.update(self.rollout, generator)
            steps = self._steps_in(epoch) - (self._lost_steps - lost)
            speed = self._speed(steps, collected - started, time.monotonic() - collected)
            last = epoch == last_epoch or time.monotonic() > deadline
            self._complete(epoch, {**rewards, **_tagged("ppo", statistics), **speed}, log, last)
            if epoch % self.config.checkpoint.every == 0 or last:
                self._save()
            if last:
                break

    def _collect(self, epoch: int, log: Log) -> dict[str, float]:
        """Fill the rollout with one epoch and compute its returns; return the epoch's reward statistics."""
        env, rollout = self.env, self.rollout
        actor = self.model.actor_arrays(self.config.seed)
        while True:
            collected = env.collect(actor, epoch, self.config.learned_steps(epoch), lambda n: log.step(epoch, n))
            log.events(epoch, env.drain_events())
            log.incidents(env.drain_incidents(), env.names)
            if collected.valid.any():
                break
        trajectories = collected.valid_part()
        self._lost_steps += max(0, self._steps_in(epoch) - trajectories.reward.size)
        rollout.load(trajectories, self.model)
        rollout.compute_returns(self.config.ppo.gamma, self.config.ppo.lam)

        # Sums over the epoch per environment, which compare between epochs with different numbers of episodes.
        values = {RETURN: float(rollout.rewards.sum(0, dtype=torch.float64).mean())}
        for tag, ends in ((TERMINATED, trajectories.terminated), (TRUNCATED, trajectories.truncated)):
            values[tag] = float(ends.sum(axis=0).mean())
        ended = trajectories.terminated.sum() + trajectories.truncated.sum()
        if self.config.env.hold.first_step is not None and ended:
            # A dropped object terminates an episode, so a truncated episode still holds its object.
            values[HELD] = float(trajectories.truncated.sum() / ended)
        terms = trajectories.reward_terms.mean(axis=0, dtype=np.float64)
        return values | _tagged("reward", dict(zip(env.reward_terms, terms, strict=True)))

    def _speed(self, steps: int, collect_s: float, update_s: float) -> dict[str, float]:
        seconds = collect_s + update_s
        own = {STEPS_PER_SECOND: steps / seconds, UPDATE_SHARE: update_s / seconds}
        return {**_tagged("speed", self.env.timing()), **own}

    def _complete(self, epoch: int, values: dict[str, float], log: Log, last: bool = False) -> None:
        """Evaluate if due, log, and take the snapshot that marks the epoch as completed."""
        self.epoch = epoch
        gif = None
        if self.evaluate is not None and (last or self._is_evaluated(epoch)):
            with log.evaluation():
                results = dict(self.evaluate(self.model.policy()))
            gif = results.pop("gif", None)
            values = {**values, **_tagged("eval", results)}
        # Epoch 0 is the state before training, so it is never the best.
        best = epoch > 0 and SUCCESS in values and values[SUCCESS] >= (self.best_success or 0.0)
        if best:
            self.best_success = values[SUCCESS]
        if values:
            log.epoch(epoch, values, gif)
        self._completed = self._snapshot()
        if best:
            checkpoints.save_best(self.run_dir, self._completed)

    def _is_evaluated(self, epoch: int) -> bool:
        """Whether there is an evaluation after an epoch that is not the last."""
        every, epochs = self.config.eval.every, self.last_epoch
        early = {math.ceil(share * epochs / 100) for share in _SHARES} if every > epochs else set[int]()
        return epoch % every == 0 or epoch in early

    def watch(self, done: int, total: int) -> None:
        """Show the progress of the running evaluation, in its own control steps."""
        if self._log is not None:
            self._log.evaluating(self.epoch, done, total)

    def _steps_in(self, epoch: int) -> int:
        """Control steps that an epoch asks of the environments."""
        return self.config.steps_in(epoch, self.env.num_envs)

    def _steps_after(self, epoch: int) -> int:
        """Control steps of the whole run at the end of an epoch, which must not precede the resumed epoch.

        Steps lost with their workers do not count.
        """
        asked = sum(map(self._steps_in, range(self._resumed_epoch + 1, epoch + 1)))
        return self._resumed_steps + asked - self._lost_steps

    @property
    def last_epoch(self) -> int:
        """The last epoch that `ppo.epochs` and `ppo.max_steps` allow; at least 1."""
        return self.config.last_epoch(self.env.num_envs, self._resumed_epoch, self._resumed_steps)

    def _open_log(self) -> Log:
        ppo = self.config.ppo
        log = Log(
            self.run_dir,
            self.config,
            self.data_stamp,
            self.env.reward_terms,
            self._steps_after,
            self.last_epoch,
            self._resumed_epoch,
        )
        log.plan(self.env.num_envs, ppo.epochs, ppo.max_steps)
        return log

    def _snapshot(self) -> Checkpoint:
        return Checkpoint(
            epoch=self.epoch,
            model=checkpoints.to_cpu(self.model.state_dict()),
            optimizer=checkpoints.to_cpu(self.ppo.optimizer.state_dict()),
            learning_rate=self.ppo.learning_rate,
            architecture=self.model.architecture(),
            config=self.config.model_dump(mode="json"),
            data=self.data_stamp,
            code=__version__,
            best_success=self.best_success,
        )

    def _save(self) -> Path:
        path = checkpoints.save(self.run_dir, self._completed)
        checkpoints.prune(self.run_dir, self.config.checkpoint.keep)
        return path

    def _restore(self) -> None:
        path = checkpoints.latest(self.run_dir)
        found = checkpoints.load(path)
        checkpoints.restore(found, path, self.model, self.ppo.optimizer)
        ppo, rate = self.config.ppo, self.ppo.learning_rate
        within = min(max(rate, ppo.min_learning_rate), ppo.max_learning_rate)
        self.ppo.learning_rate = within if ppo.adaptive_learning_rate else ppo.learning_rate
        self.epoch = self._resumed_epoch = found.epoch
        self.best_success = found.best_success
        made = steps_made(self.run_dir, found.epoch)
        self._resumed_steps = sum(map(self._steps_in, range(1, found.epoch + 1))) if made is None else made
        self._notices.append(f"resumed after epoch {found.epoch} from {path}")
        for name, there, here in (
            ("config", flat_keys(found.config), flat_keys(self.config.model_dump(mode="json"))),
            ("data", flat_keys(found.data), flat_keys(self.data_stamp)),
        ):
            changed = [key for key in sorted({*there, *here}) if there.get(key) != here.get(key)]
            if changed:
                self._notices.append(f"note: the {name} differs from the checkpoint's in {', '.join(changed)}")


def _tagged(group: str, values: Mapping[str, Any]) -> dict[str, float]:
    return {f"{group}/{name}": float(value) for name, value in values.items()}
