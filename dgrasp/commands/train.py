"""Train a grasping policy: `python train.py --cfg cfg/dexycb.yaml [key=value ...]`."""

from __future__ import annotations

import argparse
from pathlib import Path

from dgrasp.config.experiment import Config, find_config, load_config
from dgrasp.config.values import override
from dgrasp.errors import ConfigError

HELP = """\
Train a grasping policy with PPO on all labels of a split, one environment per label.

The data is looked for in this order: --data, DGRASP_DATA, DEX_YCB_DIR, a folder like the authors' release under data/,
the free set. The first line of output says what was found. Config keys can be set at the end of the command line.

examples:
  python train.py --cfg cfg/dexycb.yaml                              all objects
  python train.py --cfg cfg/dexycb.yaml labels.objects=[004_sugar_box]   one object
  python train.py --cfg cfg/dexycb.yaml --data free ppo.epochs=50 pool.workers=4
  python train.py --resume runs/dexycb_1                             continue an interrupted run
  python train.py --cfg cfg/flat_rl.yaml                             a baseline; another is cfg/learned_motion.yaml
  tensorboard --logdir runs                                          watch the training
"""


_STEPS_PER_CORE = {"pybullet": 250, "mujoco": 1000}
"""Control steps per second and core, within a factor of three (docs/speed.md). Other engines count as 1000."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `train`."""
    parser.add_argument("--cfg", type=Path, metavar="FILE", help="config file, such as cfg/dexycb.yaml")
    parser.add_argument("--run", type=Path, metavar="DIR", help="run directory (default: runs/NAME_K, a new one)")
    parser.add_argument("--data", metavar="free|DIR", help="the free set, or a folder like the authors' release")
    parser.add_argument("--resume", type=Path, metavar="DIR", help="continue the run in DIR from its last checkpoint")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys, such as ppo.epochs=100 seed=3")


def main(arguments: argparse.Namespace) -> int:
    """Run the training that the command line describes; returns the exit code."""
    overrides = list(arguments.overrides)
    if arguments.data is not None:
        overrides.append(override("data", arguments.data))
    if arguments.resume is None:
        config = load_config(find_config(arguments.cfg), overrides)
        if arguments.cfg is None:
            raise _no_config(config)
        # Imported late, here and in other commands, so that `--help` and refusals answer at once.
        from dgrasp.training import begin

        begin(config, arguments.run)
        return 0
    if arguments.run is not None or arguments.cfg is not None:
        raise ConfigError("--resume takes cfg and run directory from the run itself; leave out --cfg and --run")
    from dgrasp.training import resume

    resume(arguments.resume, overrides)
    return 0


def _no_config(config: Config) -> ConfigError:
    """The error for a command line without --cfg. config: the defaults, which are the paper's, with what was typed."""
    from dgrasp.data import resolve
    from dgrasp.pool import cores, pool_kind

    labels = len(resolve(config).labels.labels)
    epochs = config.last_epoch(labels)
    steps = sum(config.steps_in(epoch, labels) for epoch in range(1, epochs + 1))
    workers = 1 if pool_kind(config) == "serial" else config.pool.workers or cores()
    hours = steps / (_STEPS_PER_CORE.get(config.engine, 1000) * workers) / 3600.0
    if config.ppo.max_minutes is not None:
        hours = min(hours, config.ppo.max_minutes / 60.0)
    took = (f"about {hours / 24:,.0f} days" if hours >= 2 * 24
            else f"about {hours:,.0f} hours" if hours >= 2 else "under 2 hours")
    return ConfigError(f"no --cfg. Without one this would start the paper's recipe on {labels} labels: {epochs:,} "
                       f"epochs, {steps:,} control steps, {took} on {workers} cores. Expected "
                       "--cfg cfg/fast.yaml (our recipe, hours), --cfg cfg/dexycb.yaml (the paper's), another file, or "
                       "--resume DIR")
