"""From labels of one object to ranked grasps: test them, carry those that hold, and write a folder with all of it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.config.sections import INERTIA
from dgrasp.data import DataChoice
from dgrasp.errors import ConfigError, DataError
from dgrasp.eval.summary import Result, Row
from dgrasp.evaluation import evaluate_choice, evaluate_motion
from dgrasp.export.collect import display_meshes, sequences
from dgrasp.export.glb import glb_bytes
from dgrasp.export.sequence import file_name, write_sequence
from dgrasp.files.atomic import replaced_folder, write_atomic
from dgrasp.hand.model import HandModel
from dgrasp.methods import PolicyMethod
from dgrasp.methods.method import Method
from dgrasp.motion.targets import TargetSet
from dgrasp.pool import PoolSpec
from dgrasp.report.grasps import grasps_page
from dgrasp.types import EpisodeRecord

SCHEMA = 1
MADE_BY = "dgrasp grasp"
JSON_FILE, REPORT_FILE, LABELS_FILE, SEQUENCES = "grasps.json", "report.html", "labels.npz", "sequences"
_OWN = {JSON_FILE, REPORT_FILE, LABELS_FILE, SEQUENCES}
_OF_SEQUENCES = (".npz", ".glb", ".html")
"""Suffixes of the files in `SEQUENCES`; `dgrasp view` writes its page beside the sequences."""


@dataclass(frozen=True, eq=False)
class Grasps:
    """The tested grasps of one object.

    result, records, spec: of the stability test, in the label file's order. order: places of the grasps, best first.
    motion: the result of the motion, if there was one. motions: place of a grasp that holds -> its row and record.
    """

    choice: DataChoice
    result: Result
    records: list[EpisodeRecord]
    spec: PoolSpec
    order: list[int]
    motion: Result | None = None
    motions: dict[int, tuple[Row, EpisodeRecord]] = field(default_factory=dict)

    @property
    def held(self) -> list[int]:
        """Places of the grasps that hold, best first."""
        return [i for i in self.order if self.result.per_label[i]["success"]]

    @property
    def carried(self) -> list[int]:
        """Places of the grasps whose object was carried to the end of the motion, best first."""
        return [i for i in self.held if i in self.motions and self.motions[i][0]["carried"]]

    def verdict(self) -> str:
        """How many grasps hold, and how many are carried, in words."""
        text = f"{len(self.held)} of {len(self.order)} grasps hold for {self.result.window_s:g} s"
        if self.motion is not None:
            text += f", {len(self.carried)} of {len(self.held)} carry the object to the end of the motion"
        return text


def ranking(rows: Sequence[Row]) -> list[int]:
    """Places of the rows, best first: held grasps before lost ones, each kind by SimDist, the smallest first."""
    return sorted(range(len(rows)), key=lambda i: (not rows[i]["success"],
                                                   rows[i].get("sim_dist_mm_per_step", np.inf), i))


def check_policy(method: Method, hand: HandModel, named: str) -> None:
    """Raise `ConfigError` for a policy that does not grasp, or that was trained for another hand.

    named: the policy as the user gave it.
    """
    if not isinstance(method, PolicyMethod) or method.task != "grasp":
        raise ConfigError(f"--policy {named}: a policy for task {method.task}; expected one that grasps (task grasp)")
    trained = (method.trained_on or {}).get("hand")
    if isinstance(trained, str) and trained != hand.id:
        raise ConfigError(f"--policy {named}: trained for the hand {trained!r:.60}, but --hand is {hand.id!r}; "
                          "expected a hand and a policy that belong together")
    if method.policy.action_size != hand.layout.n_dof:
        raise ConfigError(f"--policy {named}: {method.policy.action_size} actions, but the hand {hand.id!r} has "
                          f"{hand.layout.n_dof} degrees of freedom; expected a hand and a policy that belong together")


def check_out(folder: Path) -> None:
    """Raise `DataError` unless `folder` is new, empty, or one that `write_grasps` wrote and nobody added to."""
    if not os.path.lexists(folder):
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


def try_grasps(method: Method, config: Config, choice: DataChoice) -> Grasps:
    """Grasp from each of the chosen labels, which are of one object, and take the table away."""
    result, records, spec = evaluate_choice(method, config, choice)
    return Grasps(choice, result, records, spec, ranking(result.per_label))


def carry(grasps: Grasps, method: Method, config: Config, target: TargetSet) -> Grasps:
    """The grasps with the motions to a target of those that hold, of which there is at least one."""
    places, of = sorted(grasps.held), grasps.choice.labels
    held = replace(grasps.choice, labels=replace(of, labels=[of.labels[i] for i in places]))
    # They have passed the stability test already.
    config = config.model_copy(update={"motion": config.motion.model_copy(update={"stable_alone": False})})
    result, records, _ = evaluate_motion(method, config, held, target)
    motions = dict(zip(places, zip(result.per_label, records, strict=True), strict=True))
    return replace(grasps, motion=result, motions=motions)


def summary(grasps: Grasps, policy: Mapping[str, Any]) -> dict[str, Any]:
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


def _entry(grasps: Grasps, place: int) -> dict[str, Any]:
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


def _stem(grasps: Grasps, place: int, moved: bool = False) -> str:
    """The name of a sequence's files without their suffix. moved: of the motion, in place of the stability test."""
    return Path(file_name(grasps.choice.labels.labels[place])).stem + "_motion" * moved


def table_cells(grasps: Grasps) -> tuple[list[str], list[list[str]]]:
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


def write_grasps(folder: Path, grasps: Grasps, labels: Path, policy: Mapping[str, Any]) -> None:
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

