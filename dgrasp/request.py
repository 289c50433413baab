"""What a command line of `test.py` may say, and what it asks for: its config, and the baseline or policy."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import re
from pathlib import Path
from typing import Any

from dgrasp.config.experiment import Config, find_config, make_config, read_values
from dgrasp.config.sections import SENSES
from dgrasp.config.values import apply_overrides
from dgrasp.errors import ConfigError
from dgrasp.files.paths import data_root
from dgrasp.methods import BASELINES, TRAINED_BASELINES, method_of
from dgrasp.methods.policy import Method, PolicyMethod
from dgrasp.methods.static_grasp import StaticGrasp
from dgrasp.rl.run import checkpoint
from dgrasp.rl.run.policies import SavedPolicy, read_policy
from dgrasp.rl.run.weights import SUFFIX
from dgrasp.tables.plan import NAMES
from raisim_like.registry import BATCHES

PRETRAINED = "pretrained"
PRETRAINED_FILE = Path("free/policy/all_objects.safetensors")
"""What `--run pretrained` stands for: the policy that ships, below the shipped data."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `test`."""
    parser.add_argument("--baseline", choices=sorted([*BASELINES, *TRAINED_BASELINES]), help="a baseline of the "
                        "paper; static_grasp takes its grasps from --run or --policy, else from the labels by PD; "
                        "flat_rl and learned_motion are runs of their own")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--run", type=Path, metavar="DIR|pretrained", help="the last checkpoint of a training run, or "
                      "the policy that ships")
    what.add_argument("--policy", type=Path, metavar="FILE", help="a checkpoint, ours or one of the authors'; or "
                      "weights of `dgrasp publish`")
    parser.add_argument("--table", choices=(*NAMES, "all"), help="a table of the paper: evaluate what is there, say "
                        "how to train the rest")
    parser.add_argument("--budget", type=_minutes, metavar="MINUTES",
                        help="with --table: train what is missing, so long")
    parser.add_argument("--seeds", type=_numbers, default=[], metavar="K,K,...",
                        help="with --table: policies of these seeds, averaged (default: the config's one)")
    parser.add_argument("--runs", type=Path, metavar="DIR",
                        help="with --table: where its runs and results are (default: runs/tables)")
    parser.add_argument("--motion", metavar="easy|near|ood|circle|pour|FILE",
                        help="move the object to targets: the authors', own ones, a path, or a file of poses")
    parser.add_argument("--cfg", type=Path, metavar="FILE", help="experiment (default: the run's, the policy's, or "
                        "cfg/dexycb.yaml)")
    parser.add_argument("--data", metavar="free|DIR", help="the free set, or a folder like the authors' release")
    parser.add_argument("--split", choices=("train", "test"), help="which labels (default: train)")
    parser.add_argument("--labels", metavar="SOURCE|FILE", help="dexycb, grasptta, contactopt, or a label file")
    parser.add_argument("--objects", nargs="+", metavar="NAME", help="only these objects, such as 004_sugar_box")
    parser.add_argument("--engine", choices=list(BATCHES), help="physics engine")
    parser.add_argument("--window", type=float, metavar="SECONDS",
                        help="stability window (default: 5; the authors: 3.87)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write JSON, and CSV, markdown, LaTeX beside it")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write one HTML page: table, charts, replays in 3D")
    parser.add_argument("--records", type=Path, metavar="DIR", help="store every sequence in a new folder, for `dgrasp "
                        "export`")
    parser.add_argument("--gif", type=Path, metavar="FILE", help="write a GIF of some of the grasps")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys, such as seed=3 pool.workers=2")


def _numbers(text: str) -> list[int]:
    if not re.fullmatch(r"\d+(,\d+)*", text):
        raise argparse.ArgumentTypeError(f"{text!r}: expected seeds, whole numbers with commas between, such as 1,2,3")
    return [int(word) for word in text.split(",")]


def _minutes(text: str) -> float:
    with contextlib.suppress(ValueError):
        minutes = float(text)
        if math.isfinite(minutes) and minutes > 0.0:
            return minutes
    raise argparse.ArgumentTypeError(f"{text!r}: expected minutes, more than 0")


def config_of(arguments: argparse.Namespace) -> Config:
    """The config: --cfg, or the run's or policy's own, or the paper's, with the options and key=value laid over it."""
    path = policy_file(arguments)
    saved = None if path is None else read_policy(path)
    where, values = _base(arguments, path, saved)
    # `--objects A B seed=3`: what holds an equals sign is not an object.
    objects = None if arguments.objects is None else [name for name in arguments.objects if "=" not in name]
    trailing = [word for word in arguments.objects or [] if "=" in word]
    given = {
        "data": arguments.data,
        "labels.split": arguments.split,
        "labels.source": arguments.labels,
        "labels.objects": objects,
        "engine": arguments.engine,
        "eval.window_s": arguments.window,
        "motion.targets": arguments.motion,
    }
    overrides = [f"{key}={json.dumps(value)}" for key, value in given.items() if value is not None]
    # A run may train with faster physics; a test has the best there is. What is typed last wins, so key=value stands
    # above the options that are short for it.
    words = ["physics.preset=faithful", *overrides, *trailing, *arguments.overrides]
    config = make_config(apply_overrides(values, words), where)
    if path is None and arguments.run is not None:
        path = checkpoint.latest(arguments.run)
        saved = read_policy(path)
    if path is not None and saved is not None:
        _check_senses(saved, config, path)
    return config


def policy_file(arguments: argparse.Namespace) -> Path | None:
    """The file of --policy, or of `--run pretrained`; None where neither was asked for."""
    if not _is_pretrained(arguments):
        path: Path | None = arguments.policy
        return path
    file = data_root() / PRETRAINED_FILE
    if not file.is_file():
        raise ConfigError(f"--run {PRETRAINED}: {file} is not there; expected a run directory, or a file for --policy")
    return file


def _is_pretrained(arguments: argparse.Namespace) -> bool:
    return str(arguments.run) == PRETRAINED and not arguments.run.exists()


def _base(
    arguments: argparse.Namespace, path: Path | None, saved: SavedPolicy | None
) -> tuple[str, dict[str, Any]]:
    """What the overrides are laid over, and where it is from: --cfg, the run's or the policy's own config, or the
    paper's."""
    cfg = find_config(arguments.cfg)
    if cfg is None and path is not None and saved is not None and saved.config:
        # Who is given a policy may not have the engine it was trained on.
        told = ("engine",) if path.suffix == SUFFIX else ()
        return str(path), {key: value for key, value in saved.config.items() if key not in told}
    if cfg is None and arguments.run is not None and not _is_pretrained(arguments):
        cfg = arguments.run / "config.yaml"
        if not cfg.is_file():
            raise ConfigError(f"{arguments.run}: not a run directory (no config.yaml); expected one that train.py made")
    cfg = cfg or find_config(Path("cfg/dexycb.yaml"))
    assert cfg is not None
    return str(cfg), read_values(cfg)


def _check_senses(saved: SavedPolicy, config: Config, path: Path) -> None:
    """A policy must see and move what it did in training; other features may have the same number of entries."""
    trained = make_config({"env": saved.env}, str(path)).env
    differ = [key for key in SENSES if getattr(trained, key) != getattr(config.env, key)]
    if differ:
        own = ", ".join(f"env.{key}={getattr(trained, key)}" for key in differ)
        raise ConfigError(f"{path} was trained with {own}, and the config says otherwise; leave --cfg and these keys "
                          "away: a policy brings its own")


def method_for(arguments: argparse.Namespace) -> Method:
    """The baseline or policy; a `ConfigError` where the options name none, or two."""
    learned = arguments.run is not None or arguments.policy is not None
    if arguments.baseline in TRAINED_BASELINES:
        return _trained_baseline(arguments, learned)
    if arguments.baseline == StaticGrasp.name:
        return StaticGrasp(_policy(arguments) if learned else None)
    if learned == (arguments.baseline is not None):
        raise ConfigError("what to test: expected one of --baseline, --run and --policy (--baseline static_grasp may "
                          "take its grasps from one of the others)")
    return _policy(arguments) if learned else BASELINES[arguments.baseline]()


def _trained_baseline(arguments: argparse.Namespace, learned: bool) -> Method:
    kind = TRAINED_BASELINES[arguments.baseline]
    train = f"python train.py --cfg cfg/{kind.name}.yaml" + " motion.policy=FILE.pt" * (kind.task == "motion")
    if not learned:
        raise ConfigError(f"--baseline {kind.name} is a policy of its own: expected --run DIR too. "
                          f"To train one: {train}")
    method = _policy(arguments)
    if not isinstance(method, kind):
        raise ConfigError(f"{arguments.run or arguments.policy}: not a policy of {kind.name} but one of task "
                          f"{_task(method)}; expected one that was made by: {train}")
    return method


def _policy(arguments: argparse.Namespace) -> Method:
    return method_of(read_policy(policy_file(arguments) or checkpoint.latest(arguments.run)))


def _task(method: Method) -> str:
    """The `env.task` that a method is for."""
    made_by = method.grasp if isinstance(method, StaticGrasp) else method
    return made_by.task if isinstance(made_by, PolicyMethod) else "grasp"


def check_task(method: Method, config: Config) -> None:
    """A policy must be tested on the task that it was trained for; else a `ConfigError`."""
    task = _task(method)
    if task != config.env.task:
        raise ConfigError(f"{method.name} is of task {task}, and the config of env.task={config.env.task}; expected "
                          "the policy's own config: its --run, or --cfg RUN/config.yaml")
    if task != "grasp" and isinstance(method, StaticGrasp):
        raise ConfigError(f"--baseline static_grasp: a policy of task {task} makes no grasp to hold; expected a "
                          "grasping policy")
