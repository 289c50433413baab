"""`dgrasp labels import mano`: make grasp labels from a table of MANO parameters and object poses."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from dgrasp.config.names import MANO_CONVENTIONS, MANO_SOURCES
from dgrasp.errors import DataError
from dgrasp.files import licences
from dgrasp.labels.recorded.common import add_common

HELP = """\
Make grasp labels from a .npz or .csv of MANO parameters and object poses, such as the raw outputs of GraspTTA and
ContactOpt. docs/labels.md lists the names of arrays and columns. Data sets follow different conventions, and none is
assumed: state them with the options below, or provide the key points (`joints`), from which they are found.

examples:
  dgrasp labels import mano estimates.npz --from hamer --mano MANO_RIGHT.pkl --hand hands/mine --out mine.npz
  dgrasp labels import mano grasps.npz --mano MANO_RIGHT.pkl --hand hands/mine --objects YCB_models --out mine.npz \\
      --pose axis-angle --mean flat --fingers mano --transl mano --quaternion xyzw
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `labels import mano`."""
    parser.add_argument("source", type=Path, metavar="FILE",
                        help="a .npz or .csv, or with --from a file of that source")
    add_common(parser, objects="objects of `dgrasp object add`")
    meanings = {
        "pose": "what hand_pose holds", "mean": "zero of hand_pose: the flat hand or MANO's mean pose",
        "fingers": "index, middle, little, ring, thumb (mano) or index, middle, ring, little, thumb (project)",
        "transl": "MANO's translation of the mesh, or the wrist's position", "quaternion": "order in object_rotation",
    }  # fmt: skip
    for question, meaning in meanings.items():
        parser.add_argument(f"--{question}", choices=MANO_CONVENTIONS[question], help=meaning)
    parser.add_argument("--from", dest="origin", choices=MANO_SOURCES,
                        help="the data set or estimator that wrote the file; answers the questions above and reads its "
                             "names")
    parser.add_argument("--rotation6d", choices=("columns", "rows"), default="columns",
                        help="what 6D rotations hold: a matrix's first two columns (default) or its first two rows")
    parser.add_argument("--scale", type=float, metavar="S",
                        help="take the grasps of this scale, where DexGraspNet has several of an object")
    parser.add_argument("--mean-shape", action="store_true", help="the hands have MANO's mean shape (no betas)")
    parser.add_argument("--object", metavar="NAME", help="the object of all rows, if the table has no names")
    parser.add_argument("--object-at-origin", action="store_true",
                        help="the objects lie at the origin of the hands' frame, not rotated (no object poses)")
    parser.add_argument("--table", type=float, metavar="Z",
                        help="m; z of the table's top in a frame whose z is up (default: no table; the object is later "
                             "placed on one in the orientation of its own frame)")
    parser.add_argument("--licence", default=licences.MANO, help="the licence of the labels (default: MANO's)")


def main(arguments: argparse.Namespace) -> int:
    """Import and write the labels; returns the exit code."""
    if arguments.table is not None and not (math.isfinite(arguments.table) and abs(arguments.table) <= 10.0):
        raise DataError(f"--table {arguments.table:g}: expected metres, at most 10")

    from dgrasp.labels.recorded.common import finish, make_maker, progress
    from dgrasp.labels.recorded.conventions import read_grasps
    from dgrasp.labels.recorded.making import numbered
    from dgrasp.labels.recorded.mano_table import read_mano_table
    from dgrasp.labels.recorded.table_sources import TABLE_SOURCES
    from dgrasp.scene.scene import TABLE_TOP
    from dgrasp.scene.standing import PLACE_XY

    maker = make_maker(arguments, [])
    source = None if arguments.origin is None else TABLE_SOURCES[arguments.origin]
    table = read_mano_table(arguments.source, arguments.object, maker.surfaces.known, source,
                            arguments.rotation6d == "rows", arguments.scale)
    maker.surfaces.scale = table.scale
    given = {question: getattr(arguments, question) for question in MANO_CONVENTIONS if getattr(arguments, question)}
    mean_shape, at_origin = arguments.mean_shape, arguments.object_at_origin
    if source is not None:
        own, given = given, dict(source.answers) | given
        mean_shape |= "betas" not in table.values
        at_origin |= not {"object_rotation", "object_translation"} & set(table.values)
    grasps = read_grasps(table, maker.model, given, mean_shape, at_origin)
    notes = ["mean shape"] * mean_shape + ["object at the origin"] * at_origin
    notes += [] if table.scale is None else [f"meshes of unit size x {table.scale:g}"]
    answers = dict(grasps.answers)
    if source is not None:
        answers = {question: answer if question in own else answer.replace("given", f"as {arguments.origin} has it")
                   for question, answer in answers.items()}
    print("conventions: " + ", ".join([*(f"{question} {answer}" for question, answer in answers.items()), *notes]))
    labels, skipped = [], {}
    for row in progress(list(range(len(table))), "making labels"):
        T_OH = np.linalg.inv(grasps.T_AO[row]) @ grasps.T_AH[row]
        name, pose = table.objects[row], grasps.hand_pose[row]
        contacts = maker.contacts(maker.model, grasps.betas[row], T_OH, pose, name)
        if not contacts.any():
            away = np.linalg.norm(T_OH[:3, 3])
            skipped[f"row {row}"] = ("hand does not touch the object", f"{name}, wrist {away:.2g} m from its origin")
            continue
        # Without a table the world is the object's frame, as for the labels of the authors' release.
        T_WO, T_WH = np.eye(4), T_OH
        if arguments.table is not None:
            # The position of the frame's origin on the table is arbitrary, so the object goes to the usual place.
            T_WA = np.eye(4)
            T_WA[:3, 3] = *(np.array(PLACE_XY) - grasps.T_AO[row][:2, 3]), TABLE_TOP - arguments.table
            T_WO, T_WH = T_WA @ grasps.T_AO[row], T_WA @ grasps.T_AH[row]
        labels.append(maker.label(name, T_WH, pose, T_WO, contacts, None, f"{table.path.name}:{row}"[:200],
                                  on_table=arguments.table is not None))
    return finish(arguments, numbered(labels), skipped, {
        "made by": "dgrasp labels import mano", "table": table.path.name, "conventions": answers,
    }, arguments.licence)  # fmt: skip
