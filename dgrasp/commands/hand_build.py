"""`dgrasp hand build`: build a hand for the physics from a MANO file, or from the free hand's skin."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import yaml

from dgrasp.errors import DataError
from dgrasp.files import licences
from dgrasp.types import Array

HELP = """\
Build a hand for the physics from MANO_RIGHT.pkl or MANO_LEFT.pkl, or, with --free, from the free hand's skin that
comes with the package. Writes a URDF with 16 closed part meshes, collision shapes, masses and 51 joints with limits to
a new folder. Use the hand with hand=DIR. A MANO file is read without chumpy, and nothing in it is executed.
MANO's licence covers a hand built from MANO: you may not redistribute it. A hand built with --free has the project's
licence.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `hand build`."""
    origin = parser.add_mutually_exclusive_group(required=True)
    origin.add_argument("--mano", type=Path, metavar="FILE", help="MANO_RIGHT.pkl or MANO_LEFT.pkl")
    origin.add_argument("--free", action="store_true",
                        help="use the free hand's skin (docs/hands.md lists its betas)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the new folder")
    parser.add_argument("--betas", nargs="+", default=[], metavar="B",
                        help="shape parameters: numbers, or one YAML file that holds a list or an entry betas, such "
                             "as DexYCB's mano.yml (default: the mean shape)")
    parser.add_argument("--side", choices=("right", "left"),
                        help="side of the hand; mirrors the model if the file has the other side (default: the "
                             "file's side)")
    parser.add_argument("--shapes", choices=("primitives", "hulls"), default="primitives",
                        help="collision shapes: capsules and a box for the palm (default), or convex hulls")
    parser.add_argument("--limits", default="table", metavar="table|LABELS",
                        help="joint limits: an anatomical table (default), or the range of the poses in a label file, "
                             "widened by 0.1 rad; its hand must have the model's side")


def main(arguments: argparse.Namespace) -> int:
    """Build the hand and print its figures; returns the exit code."""
    from dgrasp.hand.builder.build import Provenance, build_hand
    from dgrasp.hand.builder.limits import label_limits
    from dgrasp.hand.builder.report import print_report
    from dgrasp.hand.free.skin import free_limits, free_skin, skin_path
    from dgrasp.hand.mano.file import read_mano
    from dgrasp.hand.store import open_hand
    from dgrasp.labels.load import load_labels, sha256_of

    model = free_skin() if arguments.free else read_mano(arguments.mano)
    file, family = (skin_path(), "free") if arguments.free else (arguments.mano, "mano")
    licence = licences.FREE_HAND if arguments.free else licences.MANO
    side = arguments.side or model.side
    betas = read_betas(arguments.betas)
    limits, origin = free_limits() if arguments.free else None, "table"
    if arguments.limits != "table":
        labels = load_labels(Path(arguments.limits))
        limits, origin = label_limits(labels.labels), f"range of {labels.path.name} ({labels.sha256[:12]})"
    provenance = Provenance(f"{family}_{side}", file.name, sha256_of(file), origin, licence)
    identity = build_hand(model, betas, limits, arguments.shapes, provenance, arguments.out, mirror=side != model.side)
    print_report([open_hand(str(arguments.out))])
    print(f"wrote {arguments.out}: hand {identity}; use it with hand={arguments.out}; licence: {licence}")
    if model.side == "left" and len(betas) and np.any(betas):
        print("note: MANO's left file uses the right hand's shape basis without mirroring it along x; for a left hand "
              "that mirrors the right hand of these betas, build MANO_RIGHT.pkl with --side left")
    return 0


def read_betas(words: list[str]) -> Array:
    """Betas (S',) from the command line: numbers, or one YAML file."""
    try:
        return np.array([float(word) for word in words])
    except ValueError:
        pass
    if len(words) != 1:
        raise DataError(f"--betas {' '.join(words)[:200]}: expected numbers, or one YAML file")
    path = Path(words[0])
    try:
        if path.stat().st_size > 100_000:
            raise DataError(f"{path}: too large for a file of betas; expected a list of numbers")
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError, ValueError) as error:
        raise DataError(f"{path}: betas cannot be read ({' '.join(str(error).split())[:200]}); expected numbers, or a "
                        "YAML file with a list of numbers") from None
    values = content.get("betas") if isinstance(content, dict) else content
    plain = isinstance(values, list) and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
    if not plain or not values:
        raise DataError(f"{path}: no betas; expected a list of numbers, or an entry betas with such a list")
    return np.array(values, dtype=float)
