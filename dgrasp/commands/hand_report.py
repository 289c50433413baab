"""`dgrasp hand report`: print the figures of a hand, or of two hands side by side."""

from __future__ import annotations

import argparse

HELP = """\
Print volumes, masses, joint offsets and limits of a hand, or of two hands side by side.
HAND is "free", a folder that `dgrasp hand build` wrote, or a URDF file such as the authors' mano_mean.urdf.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hand report`."""
    parser.add_argument("hand", metavar="HAND")
    parser.add_argument("other", nargs="?", metavar="HAND2", help="a second hand to compare with")


def main(arguments: argparse.Namespace) -> int:
    """Print the report; returns the exit code."""
    from dgrasp.hand.builder.report import print_report
    from dgrasp.hand.store import open_hand

    names = [arguments.hand, *([arguments.other] if arguments.other else [])]
    print_report([open_hand(name) for name in names])
    return 0
