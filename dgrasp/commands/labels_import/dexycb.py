"""`dgrasp labels import dexycb`: make grasp labels from DexYCB's recordings."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path

from dgrasp.config.names import DISPLACEMENT, START_DISTANCE
from dgrasp.errors import DataError
from dgrasp.files import licences
from dgrasp.files.paths import user_cache_root
from dgrasp.labels.recorded.common import add_common

HELP = """\
Make grasp labels from DexYCB, as the paper does. The label of a right-handed sequence is the first frame in which the
object has moved, together with the approach before it. The tag of the calibration gives the position of the table.
Sequences that give no label are listed with the reason. Results are cached (DGRASP_CACHE).

example:
  dgrasp labels import dexycb $DEX_YCB_DIR --mano MANO_RIGHT.pkl --hand hands/mine --split train --out train.npz
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `labels import dexycb`."""
    parser.add_argument("source", nargs="?", type=Path, metavar="DIR", help="DexYCB's folder (default: DEX_YCB_DIR)")
    add_common(parser, objects="default: DexYCB's models/")
    parser.add_argument("--split", choices=("train", "test", "all"), default="all",
                        help="75%% or 25%% of each subject's sequences (default: all)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the split (default: 1)")
    parser.add_argument("--displacement", type=float, default=DISPLACEMENT, metavar="M",
                        help="m; the grasp is the first frame with the object farther than this from its initial "
                             "position (default: %(default)s)")
    parser.add_argument("--start-distance", type=float, default=START_DISTANCE, metavar="M",
                        help="m; the approach starts when the wrist comes this close to the object (default: "
                             "%(default)s)")
    parser.add_argument("--mirror-left", type=Path, metavar="MANO_LEFT.pkl",
                        help="also import left-handed sequences, mirrored; needs MANO's left hand")


def main(arguments: argparse.Namespace) -> int:
    """Import and write the labels; returns the exit code."""
    named = arguments.source or os.environ.get("DEX_YCB_DIR")
    if not named:
        raise DataError("no folder given and DEX_YCB_DIR is not set; expected DexYCB's folder")
    root = Path(os.path.expanduser(named))
    for option, value in (("--displacement", arguments.displacement), ("--start-distance", arguments.start_distance)):
        if not (math.isfinite(value) and 0.0 < value <= 1.0):
            raise DataError(f"{option} {value:g}: expected metres, above 0 and at most 1")
    if arguments.seed < 0:
        raise DataError(f"--seed {arguments.seed}: expected 0 or more")

    from dgrasp.hand.mano.file import read_mano
    from dgrasp.labels.load import sha256_of
    from dgrasp.labels.recorded import dexycb_grasps
    from dgrasp.labels.recorded.cache import LabelCache
    from dgrasp.labels.recorded.common import finish, make_maker, progress

    maker = make_maker(arguments, [root / "models"])
    if maker.model.side != "right":
        raise DataError(f"--mano {arguments.mano}: MANO's left hand; expected MANO_RIGHT.pkl; give the left hand with "
                        "--mirror-left")
    left = None if arguments.mirror_left is None else read_mano(arguments.mirror_left)
    if left is not None and left.side != "left":
        raise DataError(f"--mirror-left {arguments.mirror_left}: MANO's right hand; expected MANO_LEFT.pkl")
    options = dexycb_grasps.Options(
        arguments.displacement, arguments.start_distance, arguments.split, arguments.seed, left,
        "" if left is None else sha256_of(arguments.mirror_left),
    )
    imported = dexycb_grasps.import_dexycb(
        root, maker, sha256_of(arguments.mano), options, LabelCache(user_cache_root() / "labels"),
        lambda folders: progress(folders, "reading DexYCB"),
    )
    print(f"{root}: {imported.sequences} sequences, {imported.in_split} in the split {arguments.split} (seed "
          f"{arguments.seed}); {len(imported.labels)} labels, {imported.cached} results from the cache")
    if imported.flipped:
        print(f"tags whose z axis points into the table (turned about x): {imported.flipped}")
    if imported.no_start:
        print(f"labels without an approach, because the hand was first seen closer than "
              f"{arguments.start_distance:g} m: {imported.no_start}")
    return finish(arguments, imported.labels, imported.skipped, {
        "made by": "dgrasp labels import dexycb", "split": arguments.split, "seed": arguments.seed,
        "displacement_m": arguments.displacement, "start_distance_m": arguments.start_distance,
        "left_hands": "left out" if left is None else "mirrored", "sequences": imported.sequences,
    }, licences.DEXYCB)  # fmt: skip
