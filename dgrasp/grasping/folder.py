"""The folder that `dgrasp grasp` writes: the ranking as JSON, a report with replays, the labels, and sequences."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.config.sections import INERTIA
from dgrasp.errors import DataError
from dgrasp.export.collect import display_meshes, sequences
from dgrasp.export.glb import glb_bytes
from dgrasp.export.sequence import file_name, write_sequence
from dgrasp.files.atomic import replaced_folder, write_atomic
from dgrasp.grasping.grasps import TestedGrasps
from dgrasp.report.grasps import grasps_page

SCHEMA = 1
MADE_BY = "dgrasp grasp"
JSON_FILE, REPORT_FILE, LABELS_FILE, SEQUENCES = "grasps.json", "report.html", "labels.npz", "sequences"
_OWN = {JSON_FILE, REPORT_FILE, LABELS_FILE, SEQUENCES}
_OF_SEQUENCES = (".npz", ".glb", ".html")
"""Suffixes of the files in `SEQUENCES`; `dgrasp view` writes its page beside the sequences."""


def check_out(folder: Path) -> None:
    """Raise `DataError` unless `folder` is new, empty, or one that `write_grasps` wrote and nobody added to."""
    if not os.path.lexists(folder):
        above = next(path for path in folder.absolute().parents if path.exists())
        if not (above.is_dir() and os.access(above, os.W_OK)):
            raise DataError(f"--out {folder}: {above} is not a folder that can be written to; choose another place")
        return
    if not folder.is_dir():
        raise DataError(f"--out {folder}: exists and is not a folder; choose another one")
    if Path.cwd().is_relative_to(os.path.realpath(folder)):
        raise DataError(f"--out {folder}: the current folder, or one above it; choose a folder below it")
    names = {path.name for path in folder.iterdir()}
    if not names:
        return
    try:
        content = json.loads((folder / JSON_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        content = None
    if not isinstance(content, dict) or content.get("made_by") != MADE_BY:
        raise DataError(f"--out {folder}: exists, and `{MADE_BY}` did not write it; choose another folder")
    inside = folder / SEQUENCES
    foreign = [*sorted(names - _OWN), *sorted(
        f"{SEQUENCES}/{path.name}" for path in (inside.iterdir() if inside.is_dir() else ())
        if not path.is_file() or path.suffix not in _OF_SEQUENCES
    )]  # fmt: skip
    if foreign:
        raise DataError(f"--out {folder}: holds {foreign[0]}, which `{MADE_BY}` did not write and would remove; choose "
                        "another folder, or move that file")


def summary(grasps: TestedGrasps, policy: Mapping[str, Any]) -> dict[str, Any]:
    """The content of `JSON_FILE` as plain values, without anything that depends on the machine's speed or folders.

    policy: the entries on the policy.
    """
    result, choice = grasps.result, grasps.choice
    whole: dict[str, Any] = {
        "schema": SCHEMA, "made_by": MADE_BY, "object": choice.labels.objects[0], "hand": choice.hand,
        "engine": result.engine, **policy, "seed": result.seed, "window_s": result.window_s, "commit": result.commit,
        "inertia": choice.inertia, "licence": choice.licence, "data": result.data, "n_grasps": len(grasps.order),
        "n_held": len(grasps.held),
    }  # fmt: skip
    if grasps.motion is not None and grasps.motion.motion is not None:
        told = ("targets", "steps", "beta", "fingers")
        whole |= {"to": {key: grasps.motion.motion[key] for key in told}, "n_carried": len(grasps.carried)}
    return {**whole, "grasps": [_entry(grasps, i) for i in grasps.order]}


def _entry(grasps: TestedGrasps, place: int) -> dict[str, Any]:
    """The entry of one grasp: its metrics, its motion's, and its files."""
    row = grasps.result.per_label[place]
    entry = {"success": row["success"], "index": row["index"]}
    entry |= {key: value for key, value in row.items() if key != "object"}
    moved = grasps.motions[place][0] if place in grasps.motions else {}
    entry |= {key: moved[key] for key in moved if key not in ("object", "index", "target", "terminated")}
    for prefix, there, motion in (("", row["success"], False), ("motion_", moved.get("carried"), True)):
        if there:
            name = f"{SEQUENCES}/{_stem(grasps, place, motion)}"
            entry |= {f"{prefix}file": f"{name}.npz", f"{prefix}glb": f"{name}.glb"}
    return entry


def _stem(grasps: TestedGrasps, place: int, moved: bool = False) -> str:
    """The name of a sequence's files without their suffix. moved: of the motion, in place of the stability test."""
    return Path(file_name(grasps.choice.labels.labels[place])).stem + "_motion" * moved


def table_cells(grasps: TestedGrasps) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the ranking as text, best first."""
    moved = grasps.motion is not None
    motion = ["motion", "off mm", "off deg"] if moved else []
    header = ["rank", "label", "outcome", "SimDist mm/step", *motion, "file"]
    rows = []
    for rank, place in enumerate(grasps.order, 1):
        entry = _entry(grasps, place)
        outcome = "held" if entry["success"] else str(entry.get("failure", "lost"))
        if "lost_s" in entry:
            outcome += f" after {entry['lost_s']:.2f} s"
        row = [str(rank), str(entry["index"]), outcome, _number(entry, "sim_dist_mm_per_step", 1.0, 2)]
        if moved:
            way = {True: "carried", False: "lost on the way", None: ""}[entry.get("carried")]
            row += [way, _number(entry, "mpe_m", 1000.0, 0), _number(entry, "geodesic_rad", 180.0 / np.pi, 0)]
        rows.append([*row, entry.get("file", "")])
    return header, rows


def _number(entry: Mapping[str, Any], key: str, factor: float, digits: int) -> str:
    return f"{factor * entry[key]:.{digits}f}" if key in entry else ""


def write_grasps(folder: Path, grasps: TestedGrasps, labels: Path, policy: Mapping[str, Any]) -> None:
    """Write the folder in one step, in place of one that this function wrote.

    labels: the file of the labels, which is copied. policy: as `summary` takes it.
    """
    meshes = display_meshes(grasps.choice, grasps.spec)
    tested = dict(enumerate(zip(grasps.result.per_label, grasps.records, strict=True)))
    lost = [i for i in grasps.order if i not in grasps.held]
    shown = [("held", tested[i]) for i in grasps.held]
    shown += [("motions", grasps.motions[i]) for i in grasps.held if i in grasps.motions]
    shown += [("lost", tested[i]) for i in lost]
    about = summary(grasps, policy)
    facts = {"Hand": about["hand"], "Policy": about["policy"], "Engine": about["engine"],
             "Inertia": INERTIA[grasps.choice.inertia], "Seed": about["seed"], "Code": str(about["commit"])[:12],
             "Licence of the labels": about["licence"]}
    page = grasps_page(f"Grasps of {about['object']}", f"{grasps.verdict()}.", facts, table_cells(grasps),
                       [(group, record, row) for group, (row, record) in shown if len(record.gc)], meshes)
    # Resolved, because replacing a link would leave its target behind.
    with replaced_folder(Path(os.path.realpath(folder))) as fresh:
        write_atomic(fresh / LABELS_FILE, labels.read_bytes())
        (fresh / SEQUENCES).mkdir()
        for moved, result, places, of in ((False, grasps.result, grasps.held, tested),
                                          (True, grasps.motion, grasps.carried, grasps.motions)):
            if result is not None:
                some = replace(result, per_label=[of[i][0] for i in places])
                made = sequences(some, [of[i][1] for i in places], grasps.spec, grasps.choice, meshes)
                for place, sequence in zip(places, made, strict=True):
                    path = fresh / SEQUENCES / f"{_stem(grasps, place, moved)}.npz"
                    write_sequence(path, sequence)
                    write_atomic(path.with_suffix(".glb"), glb_bytes(sequence))
        write_atomic(fresh / REPORT_FILE, page)
        write_atomic(fresh / JSON_FILE, json.dumps(about, indent=2, allow_nan=False) + "\n")

