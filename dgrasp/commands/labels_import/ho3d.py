"""`dgrasp labels import ho3d`: make grasp labels from HO3D's annotations."""

from __future__ import annotations

import argparse
from pathlib import Path

from dgrasp.errors import DataError
from dgrasp.files import licences
from dgrasp.labels.recorded.common import add_common

HELP = """\
Make grasp labels from HO3D's annotations: every N-th frame of each sequence in which the hand touches the object. The
labels have no table and no approach: hand and object are placed on the table when the labels are used.

example:
  dgrasp labels import ho3d HO3D/train --mano MANO_RIGHT.pkl --hand hands/mine --objects YCB_models --out ho3d.npz
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `labels import ho3d`."""
    parser.add_argument("source", type=Path, metavar="DIR", help="HO3D's folder, or one of its splits")
    add_common(parser, objects="default: models/ in DIR")
    parser.add_argument("--every", type=int, default=100, metavar="N", help="take every N-th frame (default: 100)")


def main(arguments: argparse.Namespace) -> int:
    """Import and write the labels; returns the exit code."""
    if arguments.every < 1:
        raise DataError(f"--every {arguments.every}: expected 1 or more")

    from dgrasp.labels.recorded.common import finish, make_maker, progress
    from dgrasp.labels.recorded.ho3d import import_ho3d

    maker = make_maker(arguments, [arguments.source / "models"])
    if maker.model.side != "right":
        raise DataError(f"--mano {arguments.mano}: MANO's left hand; HO3D's hands are right hands")
    labels, skipped = import_ho3d(arguments.source, maker, arguments.every,
                                  lambda frames: progress(frames, "reading HO3D"))
    print(f"{arguments.source}: {len(labels) + len(skipped)} frames, {len(labels)} labels")
    return finish(arguments, labels, skipped, {"made by": "dgrasp labels import ho3d", "every": arguments.every},
                  licences.HO3D)
