"""`dgrasp grasp`: from a mesh, or an object, to ranked, simulated grasps and motions."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table

from dgrasp.config.experiment import make_config
from dgrasp.config.names import DENSITY, MOST_LABELS
from dgrasp.config.sections import INERTIA, which_inertia
from dgrasp.errors import ConfigError, DataError
from dgrasp.objects.add.mesh_reader import FORMATS, SCALES, read_mesh_file
from dgrasp.objects.find import build_named, find_named
from dgrasp.objects.store import check_name, clean_name, default_store
from raisim_like.engines import default_engine
from raisim_like.registry import BATCHES

if TYPE_CHECKING:
    from dgrasp.grasping.grasps import TestedGrasps
    from dgrasp.hand.store import NamedHand
    from dgrasp.request import Asked

HELP = """\
Grasp an object, from its mesh: add the object, make static grasps for a hand, let a policy grasp from each of them in
the simulator, take the table away, and rank the grasps. With --to, the wrist then carries the object of each grasp that
holds to a pose. DIR receives grasps.json, report.html with replays, labels.npz, and sequences/ with an .npz and a .glb
of each grasp that holds.

examples:
  dgrasp grasp cup.stl --units mm --mass 0.21            8 grasps of a mesh, into grasps/cup
  dgrasp grasp cup --number 20 --to "0 0 0.2"            more of the object that was added, lifted by 0.2 m
  dgrasp grasp 025_mug --to pour.csv --out mug           an object of the free set, along a path
  dgrasp grasp cup --hand hands/mine --policy mine.pt    another hand, with a policy that was trained for it
"""
_FOR_MESHES = ("name", "units", "scale", "mass", "density", "replace")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `grasp`."""
    parser.add_argument("object", metavar="MESH|OBJECT", help=f"a mesh file ({', '.join(FORMATS)}), an object of "
                        "`dgrasp object add`, or one of the 20")
    parser.add_argument("--hand", default="free", metavar="HAND",
                        help='"free", a folder of `dgrasp hand build`, or a URDF file (default: free)')
    parser.add_argument("--number", type=int, default=8, metavar="K", help="number of grasps to try (default: 8)")
    parser.add_argument("--to", metavar='"DX DY DZ [QW QX QY QZ]"|FILE', help="carry the object by this displacement "
                        "(m, z up) and rotation, or to the pose or along the path of a file (docs/motion.md)")
    parser.add_argument("--policy", default="pretrained", metavar="FILE|pretrained",
                        help="a policy for this hand: a file, a training run, or the shipped one (default)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder to write (default: grasps/OBJECT)")
    parser.add_argument("--engine", choices=list(BATCHES), default=default_engine(),
                        help="physics engine (default: %(default)s; mujoco is faster)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="another seed makes other grasps (default: 1)")
    parser.add_argument("--store", type=Path, metavar="DIR", help="folder of added objects (default: data/objects)")
    mesh = parser.add_argument_group("of a mesh, as in `dgrasp object add`")
    mesh.add_argument("--name", help="the object's name (default: the file's)")
    mesh.add_argument("--units", choices=("auto", *SCALES), help="the file's unit of length")
    mesh.add_argument("--scale", type=float, metavar="S", help="factor for the file's numbers, before the unit")
    weight = mesh.add_mutually_exclusive_group()
    weight.add_argument("--mass", type=float, metavar="KG", help="the object's mass")
    weight.add_argument("--density", type=float, metavar="KG/M3", help=f"or its density (default: {DENSITY:g})")
    mesh.add_argument("--replace", action="store_true", default=None, help="replace an object of that name")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys of the test, such as "
                        "eval.window_s=10")


@dataclass(frozen=True)
class _Plan:
    """What is to be done, once the options are checked.

    mesh: the file to add, if one is given. name: the object's. policy: the entries of the JSON on the policy.
    """

    mesh: Path | None
    name: str
    store: Path
    out: Path
    hand: NamedHand
    asked: Asked
    policy: dict[str, str]


def main(arguments: argparse.Namespace) -> int:
    """Make, test, rank and write the grasps; returns the exit code, 0 even if no grasp holds."""
    from dgrasp.evaluation import one_thread
    from dgrasp.grasping.folder import write_grasps
    from dgrasp.grasping.grasps import carry, check_policy, try_grasps
    from dgrasp.motion.files import read_target
    from dgrasp.request import make_request, method_and_config

    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="dgrasp-") as temporary:
        labels = Path(temporary) / "labels.npz"
        plan = _plan(arguments, labels)
        method, config = method_and_config(plan.asked)
        check_policy(method, plan.hand.model, arguments.policy)
        target = None if arguments.to is None else read_target(arguments.to, config.control_period)
        one_thread()
        stages = _Stages(2 + (plan.mesh is not None) + (target is not None))
        if plan.mesh is not None:
            _add(stages, arguments, plan, plan.mesh)
        _make(stages, arguments, plan, labels)
        request = make_request(plan.asked)
        stages.begin(f"testing {arguments.number} grasps of the policy {plan.policy['policy']}")
        print(request.choice.describe(), flush=True)
        grasps = try_grasps(request.method, request.config, request.choice)
        stages.end(grasps.verdict())
        if target is not None and grasps.held:
            stages.begin(f"carrying {len(grasps.held)} objects to {target.name}")
            grasps = carry(grasps, request.method, request.config, target)
            stages.end(grasps.verdict())
        write_grasps(plan.out, grasps, labels, plan.policy)
    _print(plan, grasps, time.monotonic() - begin)
    return 0


def _plan(arguments: argparse.Namespace, labels: Path) -> _Plan:
    """Check the options before anything is made. labels: the file that will hold the labels."""
    if not 1 <= arguments.number <= MOST_LABELS:
        raise ConfigError(f"--number {arguments.number}: expected 1 to {MOST_LABELS} grasps")
    if arguments.seed < 0:
        raise ConfigError(f"--seed {arguments.seed}: expected a whole number of at least 0")
    store = arguments.store or default_store()
    mesh, name = _object(arguments, store)

    from dgrasp.build import require_engine
    from dgrasp.grasping.folder import check_out
    from dgrasp.hand.store import FREE_HAND, open_hand
    from dgrasp.labels.load import sha256_of
    from dgrasp.motion.files import read_target
    from dgrasp.request import Asked, config_of
    from dgrasp.rl.run.folder import PRETRAINED
    from dgrasp.rl.run.whole import check_policy_file

    out = arguments.out or Path("grasps") / name
    check_out(out)
    if arguments.to is not None:
        read_target(arguments.to, make_config({}).control_period)
    values = {
        "data": "free", "hand": None if arguments.hand == FREE_HAND else arguments.hand, "engine": arguments.engine,
        "seed": arguments.seed, "objects": str(store) if mesh or (store / name).is_dir() else None,
        "labels.source": str(labels), "labels.objects": [], "labels.limit_per_object": None, "motion.targets": None,
    }  # fmt: skip
    fixed = [word for word in arguments.overrides if word.partition("=")[0] in values]
    if fixed:
        raise ConfigError(f"{fixed[0]}: not a key of this command; expected its option, such as --engine or --seed")
    run = Path(arguments.policy) if arguments.policy == PRETRAINED or Path(arguments.policy).is_dir() else None
    asked = Asked(policy=None if run else Path(arguments.policy), run=run, values=values, overrides=arguments.overrides)
    file = asked.find_policy()
    assert file is not None
    check_policy_file(file)
    config_of(asked)
    hand = open_hand(arguments.hand)
    require_engine(arguments.engine, "--engine")
    about = {"policy": PRETRAINED if asked.shipped else file.name, "policy_sha256": sha256_of(file)}
    return _Plan(mesh, name, store, out, hand, asked, about)


def _object(arguments: argparse.Namespace, store: Path) -> tuple[Path | None, str]:
    """The mesh file, if one is given, and the object's full name."""
    path, options = Path(arguments.object), {key: getattr(arguments, key) for key in _FOR_MESHES}
    if path.is_dir() and not (store / arguments.object).is_dir():
        raise DataError(f"{path}: a folder; expected a mesh file ({', '.join(FORMATS)}) or the name of an object")
    if path.suffix.lower()[1:] not in FORMATS and not path.is_file():
        given = [f"--{key}" for key, value in options.items() if value is not None]
        if given:
            raise ConfigError(f"{given[0]}: only for a mesh file, but {arguments.object} is the name of an object, "
                              "which has its own")
        found = find_named(arguments.object, store)
        return None, found if isinstance(found, str) else found.folder.name
    for key in ("mass", "density", "scale"):
        if options[key] is not None and not 0.0 < options[key] < float("inf"):
            raise DataError(f"--{key} {options[key]:g}: expected a positive number")
    name = arguments.name or clean_name(path.stem)
    check_name(name, path)
    read_mesh_file(path).scaled(arguments.units or "auto", arguments.scale or 1.0)
    return path, name


class _Stages:
    """Prints which stage of the whole begins, and what came of it in how much time."""

    def __init__(self, number: int) -> None:
        self._number, self._present = number, 0

    def begin(self, text: str) -> None:
        self._present, self._begin = self._present + 1, time.monotonic()
        print(f"[{self._present}/{self._number}] {text} ...", flush=True)

    def end(self, text: str) -> None:
        print(f"[{self._present}/{self._number}] {text} ({time.monotonic() - self._begin:.0f} s)", flush=True)


def _add(stages: _Stages, arguments: argparse.Namespace, plan: _Plan, mesh: Path) -> None:
    """Add the mesh as an object."""
    from dgrasp.objects.add.add import Mass, add_object

    stages.begin(f"adding {mesh}")
    mass = Mass(arguments.mass, arguments.density or DENSITY)
    added = add_object(mesh, plan.store, plan.name, arguments.units or "auto", mass,
                       replace=bool(arguments.replace), scale=arguments.scale or 1.0)
    grams, remarks = 1000.0 * added.meta["mass_kg"], added.meta["figures"]["remarks"]
    stages.end("; ".join([f"{added.folder}: {grams:.4g} g", *remarks]))


def _make(stages: _Stages, arguments: argparse.Namespace, plan: _Plan, file: Path) -> None:
    """Make the labels and write them to the file."""
    from dgrasp.labels.recorded.making import numbered
    from dgrasp.synthesis.making import make_labels, write_labels
    from dgrasp.synthesis.progress import shown_progress

    config = make_config({"engine": arguments.engine}, "grasp")
    model = build_named(find_named(plan.name, plan.store), None, config)
    inertia = which_inertia([config.physics.authors_inertia(False)])
    stages.begin(f"making {arguments.number} labels of {plan.name} for the hand {plan.hand.model.id} on "
                 f"{arguments.engine}; {INERTIA[inertia]}")
    with shown_progress(plan.name) as report:
        made, row = make_labels(plan.hand, model, arguments.number, arguments.seed, config, report)
    write_labels({file: numbered(made)}, plan.hand, {plan.name: row}, True, seed=arguments.seed,
                 engine=arguments.engine, inertia=inertia)
    stages.end(f"{len(made)} labels; PD control alone holds {row['held']} of them")


def _print(plan: _Plan, grasps: TestedGrasps, seconds: float) -> None:
    """Print the ranking, where the files are, and what to do next."""
    from dgrasp.files.typed import typed
    from dgrasp.grasping.folder import JSON_FILE, REPORT_FILE, SEQUENCES, table_cells

    header, rows = table_cells(grasps)
    table = Table(*header, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for row in rows[:20]:
        table.add_row(*row)
    # In a file or a pipe, a wide table keeps each row on one line.
    Console(highlight=False, width=None if sys.stdout.isatty() else 120).print(table)
    print(f"{grasps.verdict()} ({seconds:.0f} s in all)")
    print(f"wrote {plan.out}: {JSON_FILE} (all {len(rows)} grasps), {REPORT_FILE} (replays), {SEQUENCES}/ "
          f"({len(grasps.held) + len(grasps.carried)} .npz and .glb)")
    if grasps.held:
        print(f"next: {typed('view', [plan.out / SEQUENCES])}")
    else:
        print("next: the same command with another --seed, or a larger --number")
