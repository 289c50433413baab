"""`dgrasp labels check`: show what a label file holds and what is wrong with it."""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from dgrasp.errors import ConfigError, DataError

if TYPE_CHECKING:
    from dgrasp.labels.quality.measure import Finding

HELP = """\
Read a label file and check every label against the hand and the objects that it would be used with. The checks cover
counts, frames, units, joint limits, penetration (cm3), distance (mm), goal contacts, height above the table, whether
the contacts could carry the object's weight, and duplicates. They are geometry and statics: nothing is simulated, so
there is no --engine. `test --baseline gt_pd --labels FILE` tries the labels in physics.

examples:
  dgrasp labels check DIR/labels/dexycb_train_labels.pkl --data DIR
  dgrasp labels check mine.npz --data DIR --hand hands/mine --html
"""
_WORST = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `labels check`."""
    parser.add_argument("file", type=Path, metavar="FILE", help="a label file")
    parser.add_argument("--data", metavar="free|DIR",
                        help="the data with the objects and the hand (default: as for training)")
    parser.add_argument("--hand", metavar="HAND", help="the hand, if it is not the hand of the data")
    parser.add_argument("--mano", metavar="FILE", help="the hand's MANO file; measures on MANO's skin")
    parser.add_argument("--store", metavar="DIR", help="folder of added objects (default: data/objects)")
    parser.add_argument("--html", nargs="?", const="", metavar="PAGE",
                        help="write a page with a picture of each label, worst first (default: FILE with .html)")
    parser.add_argument("--shapes", action="store_true",
                        help="with --html: draw the collision shapes in place of the surfaces")


def main(arguments: argparse.Namespace) -> int:
    """Check the file; returns the exit code, which is 0 even if labels have problems."""
    from dgrasp.build import build_hand, build_objects
    from dgrasp.config.experiment import make_config
    from dgrasp.data import resolve
    from dgrasp.eval.meshes import build_bodies, build_interpenetration
    from dgrasp.geometry.shape_mesh import shapes_vertices
    from dgrasp.labels.quality.measure import measure_labels
    from dgrasp.labels.quality.weight import Carrying
    from dgrasp.labels.recorded.common import progress
    from dgrasp.scene.standing import standing

    page = None if arguments.html is None else Path(arguments.html or arguments.file.with_suffix(".html"))
    if page is not None and not page.parent.is_dir():
        raise DataError(f"{page}: the folder {page.parent} does not exist")
    if arguments.shapes and page is None:
        raise ConfigError("--shapes: only valid with --html; add --html, or leave out --shapes")
    config = make_config({"data": arguments.data, "hand": arguments.hand, "labels": {"source": str(arguments.file)},
                          "eval": {"mano": arguments.mano}, "objects": arguments.store}, "labels check")
    choice = resolve(config)
    print(choice.describe(), flush=True)
    hand, objects = build_hand(choice), build_objects(choice, config)
    bodies = build_bodies(choice, objects)
    surface = build_interpenetration(choice, config, hand, bodies).surface
    meshes = {name: one.body for name, one in bodies.items()}
    carrying = Carrying(hand, meshes, {name: model.center_of_mass_O for name, model in objects.items()})
    findings = measure_labels(choice.labels.labels, hand, surface, meshes,
                              lambda labels: progress(labels, "measuring"), carrying,
                              {name: shapes_vertices(model.shapes) for name, model in objects.items()})
    _print_table(findings)
    lines = summary(findings, surface.kind)
    print("\n".join(lines))
    worst = sorted((f for f in findings if f.problems), key=lambda f: -f.badness)[:_WORST]
    for finding in worst:
        print(f"  {finding.label.name}: {'; '.join(finding.problems)}")
    if page is not None:
        from dgrasp.files.atomic import write_atomic
        from dgrasp.view.label_page import label_page, label_pictures

        pictures = label_pictures(standing(choice.labels.labels, objects), hand, objects, arguments.shapes)
        if arguments.shapes:
            lines.append(f"the pictures show the collision shapes of {config.engine}")
        write_atomic(page, label_page(f"Labels of {arguments.file.name}", [choice.describe(), *lines], findings,
                                      pictures))
        print(f"wrote {page}")
    return 0


def summary(findings: list[Finding], kind: str) -> list[str]:
    """Lines with the counts of the whole file. kind: the kind of the hand's surface (`HandSurface.kind`)."""
    labels = [finding.label for finding in findings]
    volumes = [f.penetration_cm3 for f in findings if f.penetration_cm3 is not None]
    wrong = [finding for finding in findings if finding.problems]
    tables = [f.table_mm for f in findings if f.table_mm is not None]
    lines = [
        f"{len(labels)} labels of {len({label.object_id for label in labels})} objects: "
        f"{sum(label.start is not None for label in labels)} with an approach, "
        f"{sum(label.on_table for label in labels)} with a table; metres, radians and rigid frames checked",
        f"penetration (on {kind}): mean {statistics.fmean(volumes) if volumes else 0.0:.2f} cm3; "
        f"{sum(f.distance_mm > 0.0 for f in findings)} hands do not reach the object",
        f"{sum(f.beyond_limits > 0 for f in findings)} labels have angles beyond the hand's limits, "
        f"{statistics.fmean(f.beyond_limits for f in findings):.1f} of {len(labels[0].hand_pose)} on average",
        f"{sum(f.sunk_mm > 0.0 for f in findings)} hands would reach below the table's top at their object's start; "
        f"{sum(not f.carries for f in findings)} cannot carry the object's weight with their contacts; "
        f"{sum(f.duplicate_of is not None for f in findings)} duplicates",
        f"{len(wrong)} labels with problems",
    ]
    if tables:
        lines.insert(3, f"the objects' lowest points are {min(tables):+.1f} to {max(tables):+.1f} mm above the table's "
                        f"top, median {statistics.median(tables):+.1f}")
    return lines


def _print_table(findings: list[Finding]) -> None:
    table = Table(title="means per object: penetration, distance, goal contacts, angles beyond limits")
    for column in ("object", "labels", "cm3", "mm", "contacts", "beyond", "problems"):
        table.add_column(column, justify="left" if column == "object" else "right", no_wrap=True)
    for name in dict.fromkeys(finding.label.object_id for finding in findings):
        own = [finding for finding in findings if finding.label.object_id == name]
        volumes = [f.penetration_cm3 for f in own if f.penetration_cm3 is not None]
        table.add_row(
            name, str(len(own)), f"{statistics.fmean(volumes):.2f}" if volumes else "-",
            f"{statistics.fmean(f.distance_mm for f in own):.1f}", f"{statistics.fmean(f.contacts for f in own):.1f}",
            f"{statistics.fmean(f.beyond_limits for f in own):.1f}", str(sum(bool(f.problems) for f in own)),
        )
    Console().print(table)
