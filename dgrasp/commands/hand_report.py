"""`dgrasp hand report`: the figures of a hand, or of two beside each other."""

from __future__ import annotations

import argparse

HELP = """\
Print volumes, masses, joint offsets and limits of a hand, or of two hands side by side.
A hand is "free", a folder written by `dgrasp hand build`, or a URDF file such as the authors' mano_mean.urdf.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hand report`."""
    parser.add_argument("hand", metavar="HAND")
    parser.add_argument("other", nargs="?", metavar="HAND2", help="a second hand to compare with")


def main(arguments: argparse.Namespace) -> int:
    """Print the report; returns the exit code."""
    from dgrasp.hand.build.report import print_report
    from dgrasp.hand.store import open_hand

    names = [arguments.hand, *([arguments.other] if arguments.other else [])]
    print_report([open_hand(name) for name in names])
    return 0
