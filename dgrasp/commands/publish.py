"""`dgrasp publish`: write the policy of a run or checkpoint as one small file to share."""

from __future__ import annotations

import argparse
from pathlib import Path

from dgrasp.errors import DataError
from dgrasp.rl.run.folder import BEST, latest
from dgrasp.rl.run.folder import WEIGHTS_SUFFIX as SUFFIX

HELP = """\
Write a trained policy as a .safetensors file. It holds the actor's weights and a description of the training and its
data, without the state needed to resume the training. `test.py --policy FILE.safetensors` reads it.

examples:
  dgrasp publish runs/fast_1 --out mine.safetensors            the best checkpoint of a run
  dgrasp publish runs/fast_1/checkpoints/000400.pt --out mine.safetensors
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `publish`."""
    parser.add_argument("source", type=Path, metavar="RUN|FILE.pt", help="a run directory, or a checkpoint")
    parser.add_argument("--out", type=Path, required=True, metavar=f"FILE{SUFFIX}", help="the file to write")


def main(arguments: argparse.Namespace) -> int:
    """Write the file; returns the exit code."""
    source, out = arguments.source, arguments.out
    if out.suffix != SUFFIX or not out.parent.is_dir():
        raise DataError(f"--out {out}: expected the name of a {SUFFIX} file in a folder that exists")
    if out.exists():
        raise DataError(f"--out {out} exists already; choose another name, or remove it")
    if source.is_dir():
        best = source / BEST
        source = best if best.is_file() else latest(source)
    if not source.is_file():
        raise DataError(f"{source}: no such file; expected a run directory, or a checkpoint (.pt)")

    from dgrasp.rl.run.checkpoint import load
    from dgrasp.rl.run.weights import write_weights

    read = load(source)
    size = write_weights(out, read)
    score = "" if read.best_success is None else f", best success in training {read.best_success:.2f}"
    print(f"wrote {out}: {size} bytes, from {source} ({read.epoch} epochs{score})")
    data = read.data
    print(f"trained on {data.get('labels', 'unknown labels')}; their licence: {data.get('licence', 'unknown')}")
    return 0
