"""`dgrasp publish`: write the policy of a run or checkpoint as one small file to share."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dgrasp.config.sections import INERTIA
from dgrasp.errors import DataError
from dgrasp.files.typed import typed
from dgrasp.rl.run.folder import BEST, latest
from dgrasp.rl.run.folder import WEIGHTS_SUFFIX as SUFFIX
from dgrasp.rl.run.whole import read_whole

if TYPE_CHECKING:
    from dgrasp.rl.run.checkpoint import Checkpoint

HELP = """\
Write a trained policy as a .safetensors file. It holds the actor's weights and a description of the training and its
data, without the state needed to resume the training. `test.py --policy FILE.safetensors` reads it.

examples:
  dgrasp publish runs/fast_1 --out mine.safetensors            the best checkpoint of a run
  dgrasp publish runs/fast_1 --out mine.safetensors --last     its last one
  dgrasp publish runs/fast_1/checkpoints/000400.pt --out mine.safetensors
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `publish`."""
    parser.add_argument("source", type=Path, metavar="RUN|FILE.pt", help="a run directory, or a checkpoint")
    parser.add_argument("--out", type=Path, required=True, metavar=f"FILE{SUFFIX}", help="the file to write")
    parser.add_argument("--last", action="store_true", help="take the last checkpoint of the run in place of the best")


def main(arguments: argparse.Namespace) -> int:
    """Write the file; returns the exit code."""
    source, out = arguments.source, arguments.out
    if out.suffix != SUFFIX or not out.parent.is_dir():
        raise DataError(f"--out {out}: expected the name of a {SUFFIX} file in a folder that exists")
    if out.exists():
        raise DataError(f"--out {out} exists already; choose another name, or remove it")
    if arguments.last and source.is_file():
        raise DataError(f"--last: {source} is a checkpoint; expected a run directory, or no --last")
    if not source.is_dir() and not source.is_file():
        raise DataError(f"{source}: no such file; expected a run directory, or a checkpoint (.pt)")
    read_whole(source if source.is_file() else latest(source), "a checkpoint of this project")

    from dgrasp.rl.run.checkpoint import load
    from dgrasp.rl.run.weights import write_weights

    source, read = (source, load(source)) if source.is_file() else _of_run(source, arguments.last)
    size = write_weights(out, read)
    score = "" if read.best_success is None else f", best success in training {read.best_success:.2f}"
    print(f"wrote {out}: {size} bytes, from {source} ({read.epoch} epochs{score})")
    data = read.data
    inertia = INERTIA.get(data.get("inertia", ""), "unknown inertia")
    print(f"trained on {data.get('labels', 'unknown labels')} with {inertia}; the labels' licence: "
          f"{data.get('licence', 'unknown')}")
    return 0


def _of_run(run_dir: Path, last: bool) -> tuple[Path, Checkpoint]:
    """The best checkpoint of a run or its last one; says so if they differ. Epoch 0 is never taken."""
    from dgrasp.rl.run.checkpoint import load

    newest, best = latest(run_dir), run_dir / BEST
    found = newest, load(newest)
    if best.is_file() and not last:
        read = load(best)
        if read.epoch == 0:
            print(f"no evaluation was better than before training ({BEST} is of epoch 0); taking the last checkpoint")
        else:
            if read.epoch != found[1].epoch:
                print(f"the best evaluation was after epoch {read.epoch} of {found[1].epoch}; "
                      "--last takes the last one")
            found = best, read
    if found[1].epoch == 0:
        raise DataError(f"{run_dir}: no epoch is trained yet; train on: {typed('train', ['--resume', run_dir])}")
    return found
