"""Train a grasping policy; see `python train.py --help`."""

import sys

from dgrasp.cli import run_command

if __name__ == "__main__":
    sys.exit(run_command("train", sys.argv[1:]))
