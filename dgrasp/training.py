"""Train a policy in a run directory: begin a run, resume one, and evaluate the policy during training."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dgrasp.build import build_spec, frozen_policy
from dgrasp.config.experiment import Config, load_config
from dgrasp.data import DataChoice, resolve
from dgrasp.errors import ConfigError, DataError
from dgrasp.eval.evaluator import Progress, evaluate
from dgrasp.eval.motion import choose_targets, motion_row, move, stable_grasps, usual_set
from dgrasp.eval.summary import summarise
from dgrasp.files.typed import typed
from dgrasp.methods import TRAINED
from dgrasp.methods.frozen import frozen_grasp
from dgrasp.methods.policy import PolicyMethod
from dgrasp.motion.targets import draw_targets
from dgrasp.pool import Pool, PoolSpec, make_pool
from dgrasp.rl.run.folder import BEST, saved, write_description
from dgrasp.rl.run.lock import only_run
from dgrasp.rl.run.record import read_run
from dgrasp.types import EpisodeRecord
from dgrasp.view.frames import gif_bytes, record_pictures
from dgrasp.view.meshes import scene_meshes

if TYPE_CHECKING:
    from dgrasp.rl.networks import Policy


def begin(config: Config, run_dir: Path | None = None) -> Path:
    """Train a new run to its last epoch and return its directory.

    run_dir: None takes the next free runs/NAME_K. `ConfigError` for a directory that is not empty.
    """
    if run_dir is not None and run_dir.exists() and (not run_dir.is_dir() or any(run_dir.iterdir())):
        raise _exists(run_dir)
    choice = _checked_data(config)
    run_dir = run_dir or next_run(config.name)
    start_run(run_dir, config, choice, new=True)
    train(run_dir, config, choice)
    _say_done(run_dir)
    return run_dir


def resume(run_dir: Path, overrides: Sequence[str] = ()) -> None:
    """Continue a run from its last checkpoint, with `key=value` overrides applied to its config.

    A run that was stopped before its first checkpoint starts from the beginning. `ConfigError` for a directory that is
    not a run, and for a run whose checkpoints are missing.
    """
    file = run_dir / "config.yaml"
    if not file.is_file():
        raise ConfigError(f"{run_dir}: no config.yaml there, so no run to resume; give the folder that --run named")
    config = load_config(file, list(overrides))
    choice = _checked_data(config)
    there_is_one = bool(saved(run_dir))
    if not there_is_one:
        _refuse_lost_checkpoints(run_dir)
        print(f"{run_dir} was stopped before its first checkpoint, so it starts from the beginning", flush=True)
    train(run_dir, config, choice, there_is_one)
    _say_done(run_dir)


def _checked_data(config: Config) -> DataChoice:
    """The data of a training; prints what was found. First checks that a frozen policy, if needed, can be loaded."""
    frozen_policy(config)
    choice = resolve(config)
    print(choice.describe(), flush=True)
    return choice


def _say_done(run_dir: Path) -> None:
    print(f"done: {run_dir}\ntest it:  {typed('test', ['--run', run_dir])}\n"
          f"watch it: tensorboard --logdir {shlex.quote(str(run_dir.parent))}")


def _refuse_lost_checkpoints(run_dir: Path) -> None:
    """`ConfigError` if a run without checkpoints must have had some: starting again would overwrite what is left."""
    made = read_run(run_dir)
    epochs = made.number("epoch")
    if epochs >= min(made.config.checkpoint.every, made.epochs):
        kept = f"test {BEST} with --policy, " if (run_dir / BEST).is_file() else ""
        raise ConfigError(f"{run_dir}: its checkpoints are missing after {epochs:.0f} epochs; put them back, "
                          f"{kept}or begin another run with --run")


def _exists(run_dir: Path) -> ConfigError:
    return ConfigError(f"{run_dir} exists already; continue it with --resume {shlex.quote(str(run_dir))}, or choose "
                       "another --run")


def next_run(name: str) -> Path:
    """Make and return runs/NAME_K with the first free K. Runs that begin at the same time get different directories."""
    for k in itertools.count(1):
        run_dir = Path("runs") / f"{name}_{k}"
        try:
            run_dir.mkdir(parents=True)
            return run_dir
        except FileExistsError:
            if not Path("runs").is_dir():
                raise DataError("runs: not a folder, so no run can be created in it; choose another --run") from None
        except OSError as error:
            raise _not_made(run_dir, error) from None
    raise AssertionError


def _not_made(run_dir: Path, error: OSError) -> DataError:
    return DataError(f"{run_dir}: the run directory cannot be made ({error.strerror})")


def start_run(run_dir: Path, config: Config, choice: DataChoice, new: bool = False) -> None:
    """Make the run directory with its config and its data stamp.

    `ConfigError` if another process is training there or, with `new`, if the directory already holds a run.
    """
    try:
        run_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _not_made(run_dir, error) from None
    with only_run(run_dir):
        if new and (run_dir / "config.yaml").exists():
            raise _exists(run_dir)
        write_description(run_dir, config, choice.stamp())


def train(run_dir: Path, config: Config, choice: DataChoice, resume: bool = False) -> None:
    """Train in `run_dir` to the config's last epoch."""
    # Imported late: torch takes seconds, and refusals before a training need none of it.
    import torch

    from dgrasp.rl.runner import Runner

    # The workers use all cores. They wait during the update, which may use several threads (`ppo.threads`).
    torch.set_num_threads(1)
    spec = build_spec(choice, config)
    moves = TRAINED[config.env.task].motion == "always"
    if moves and config.motion.stable_alone:
        spec = only_stable(spec)
    pool = make_pool(spec)
    try:
        make = periodic_motion if moves else periodic_evaluation
        evaluator = make(pool, spec, choice, lambda done, total: runner.watch(done, total))
        runner = Runner(pool, config, run_dir, choice.stamp(), evaluator, resume)
        runner.learn()
    finally:
        pool.close()


def periodic_evaluation(
    pool: Pool, spec: PoolSpec, choice: DataChoice, progress: Progress | None = None
) -> Callable[[Policy], dict[str, Any]]:
    """Deterministic evaluation on the pool's labels, with a GIF of one grasp, each time of another label."""
    count = 0

    def run(policy: Policy) -> dict[str, Any]:
        nonlocal count
        config = spec.config
        records, cost = evaluate(pool, PolicyMethod(policy), config, progress)
        result = summarise(
            records, method="policy", engine=config.engine, window_s=config.eval.window_s, seed=config.seed,
            data=choice.stamp(), cost=cost,
        )  # fmt: skip
        values: dict[str, Any] = dict(result.mean_over_labels)
        values["success_mean_over_objects"] = result.mean_over_objects["success"]
        values |= _gif(records, count, spec)
        count += 1
        return values

    return run


def only_stable(spec: PoolSpec) -> PoolSpec:
    """Keep only the labels for which `motion.policy` makes stable grasps, as the paper does (supplement, B.5)."""
    stable, _, _ = stable_grasps(*frozen_grasp(spec))
    print(f"{int(stable.sum())} of {len(stable)} grasps of motion.policy are stable and used for training", flush=True)
    return replace(spec, labels=[label for label, ok in zip(spec.labels, stable, strict=True) if ok])


def periodic_motion(
    pool: Pool, spec: PoolSpec, choice: DataChoice, progress: Progress | None = None
) -> Callable[[Policy], dict[str, Any]]:
    """As `periodic_evaluation`, for tasks with a target: each object moves to one target of `motion.targets`."""
    config = spec.config
    named = config.motion.model_copy(update={"targets": config.motion.targets or usual_set(choice)})
    targets = choose_targets(config.model_copy(update={"motion": named}), choice)
    which = draw_targets(len(targets.T), pool.num_envs, 1, np.random.default_rng(config.seed))[0]
    path = targets.place(which, spec.labels)
    steps = max(config.motion.steps, path.shape[1])
    kind = TRAINED[config.env.task]
    count = 0

    def run(policy: Policy) -> dict[str, Any]:
        nonlocal count
        records, _ = move(pool, kind(policy), config, path, steps, progress)
        rows = [motion_row(record, int(target), False) for record, target in zip(records, which, strict=True)]
        values: dict[str, Any] = {"carried": float(np.mean([row["carried"] for row in rows]))}
        for name in ("mpe_m", "geodesic_rad"):
            # An episode that broke before its motion has neither of the two.
            measured = [row[name] for row in rows if name in row]
            values |= {name: float(np.mean(measured))} if measured else {}
        values |= _gif(records, count, spec)
        count += 1
        return values

    return run


def _gif(records: Sequence[EpisodeRecord], count: int, spec: PoolSpec) -> dict[str, bytes]:
    """A GIF, under "gif", of one episode with at least one step; `count` selects the episode. Empty without a GIF."""
    config, shown = spec.config, [record for record in records if len(record.gc)]
    if not config.eval.gif or not shown:
        return {}
    record = shown[count * 7 % len(shown)]
    meshes = scene_meshes(spec.hand, spec.objects[record.label.object_id])
    frames = list(record_pictures(record, meshes, every=6, size=(320, 240)))
    return {"gif": gif_bytes(frames, 6 * config.control_period)}
