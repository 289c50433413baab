"""Evaluate a policy or a baseline; see `python test.py --help`."""

import sys

from dgrasp.cli import run_command

if __name__ == "__main__":
    sys.exit(run_command("test", sys.argv[1:]))
