"""The shared code of the commands `dgrasp labels import ...`: options, progress bar, summary, writing the file."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console
from rich.progress import track

from dgrasp.errors import DataError
from dgrasp.types import GraspLabel

if TYPE_CHECKING:
    from dgrasp.labels.recorded.making import LabelMaker

_EXAMPLES, MAX_REASONS = 3, 5000
_T = TypeVar("_T")


def add_common(parser: argparse.ArgumentParser, objects: str) -> None:
    """Add the options of all kinds of import. objects: remark in the help of `--objects`, such as its default."""
    parser.add_argument("--mano", type=Path, required=True, metavar="FILE",
                        help="MANO_RIGHT.pkl, with which the source's hands were fitted; or a hand in MANO's layout "
                             "as .npz")
    parser.add_argument("--hand", required=True, metavar="HAND",
                        help="the hand for which labels are made: a folder written by `dgrasp hand build`, or "
                             "hand/mano_mean.urdf of the authors' release")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.npz", help="the label file to write")
    parser.add_argument("--objects", type=Path, metavar="DIR",
                        help=f"folder of NAME/textured_simple.obj or NAME/textured_meshlab.obj ({objects})")


def make_maker(arguments: argparse.Namespace, folders: list[Path]) -> LabelMaker:
    """The label maker that the options describe. folders: where meshes are looked for without `--objects`.

    Objects that `dgrasp object add` wrote are always found.
    """
    out = arguments.out
    if out.suffix != ".npz" or not out.parent.is_dir():
        raise DataError(f"--out {out}: expected the name of a .npz file in a folder that exists")

    from dgrasp.hand.mano.file import read_mano
    from dgrasp.labels.recorded.making import LabelMaker, target_hand
    from dgrasp.labels.recorded.surfaces import Surfaces
    from dgrasp.objects.store import default_store

    model = read_mano(arguments.mano)
    chosen = [arguments.objects] if arguments.objects is not None else folders
    return LabelMaker(target_hand(arguments.hand, model), model, Surfaces([*chosen, default_store()]))


def progress(items: list[_T], what: str) -> Iterable[_T]:
    """The items, with a bar on a terminal's stderr."""
    console = Console(stderr=True)
    return track(items, description=what, console=console, disable=not console.is_terminal)


def finish(
    arguments: argparse.Namespace, labels: list[GraspLabel], skipped: dict[str, tuple[str, str]],
    provenance: dict[str, Any], licence: str,
) -> int:
    """Print what was skipped and why, write the file, and print what it holds. Returns the exit code.

    skipped: place -> reason and detail. The file's description holds provenance and reasons.
    """
    for line in summary(skipped):
        print(line)
    if not labels:
        raise DataError("no label is left; see above for what was skipped and why; nothing was written")

    from dgrasp.hand.mano.layout import MANO_NAMES
    from dgrasp.labels.formats.native import write_native
    from dgrasp.labels.load import sha256_of

    reasons = {place[:200]: reason for place, (reason, _) in list(skipped.items())[:MAX_REASONS]}
    write_native(arguments.out, labels, {
        **provenance, "mano_file": arguments.mano.name, "mano_sha256": sha256_of(arguments.mano), "skipped": reasons,
    }, licence, MANO_NAMES)  # fmt: skip
    counts = Counter(label.object_id for label in labels)
    print(f"wrote {arguments.out}: {len(labels)} labels of {len(counts)} objects for the hand {labels[0].hand}; "
          f"licence: {licence}")
    print("  " + ", ".join(f"{name} {count}" for name, count in sorted(counts.items())))
    sys.stdout.flush()
    return 0


def summary(skipped: dict[str, tuple[str, str]]) -> list[str]:
    """One line per reason, most frequent first, with a few examples of skipped places."""
    lines = []
    for reason, count in Counter(reason for reason, _ in skipped.values()).most_common():
        places = [(place, detail) for place, (why, detail) in skipped.items() if why == reason]
        shown = "; ".join(f"{place} ({detail})" if detail else place for place, detail in places[:_EXAMPLES])
        lines.append(f"skipped {count}: {reason}: {shown}{'; ...' if count > _EXAMPLES else ''}")
    return lines
