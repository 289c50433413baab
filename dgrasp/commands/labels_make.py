"""`dgrasp labels make`: synthesise static grasps for a hand and objects, and write them as a label file."""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import shutil
import signal
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dgrasp.config.experiment import Config, make_config
from dgrasp.config.names import MOST_LABELS
from dgrasp.config.sections import INERTIA, which_inertia
from dgrasp.errors import ConfigError, DataError
from dgrasp.objects.find import build_named, find_named
from dgrasp.objects.names import YCB_NAMES
from dgrasp.types import GraspLabel
from dgrasp.version import __version__
from raisim_like.engines import default_engine
from raisim_like.registry import BATCHES

if TYPE_CHECKING:
    from dgrasp.hand.store import NamedHand
    from dgrasp.objects.model import ObjectModel

HELP = """\
Make static grasp labels for a hand and objects by gradient descent (contact, force closure, penetration, joint limits,
a prior of natural hands, table). The candidates are tried in the simulator under gt_pd; a diverse selection is kept,
in which some grasps hold.

examples:
  dgrasp labels make --objects 004_sugar_box 024_bowl --number 25 --out mine.npz --engine mujoco
  dgrasp labels make --objects all --number 25 --test 124 --out free.npz      (free_train.npz and free_test.npz)
  dgrasp labels make --objects my_vase --number 50 --hand hands/mine --out vase.npz
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `labels make`."""
    parser.add_argument("--objects", nargs="+", required=True, metavar="NAME",
                        help="some of the 20 objects, or objects added by `dgrasp object add`; all: the 20")
    parser.add_argument("--number", type=int, required=True, metavar="N", help="labels per object")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.npz", help="the label file to write")
    parser.add_argument("--test", type=int, default=0, metavar="N",
                        help="write N labels, over all objects, to FILE_test.npz and the others to FILE_train.npz")
    parser.add_argument("--hand", metavar="HAND",
                        help='"free", a folder of `dgrasp hand build`, or a URDF file (default: the hand of --data)')
    parser.add_argument("--data", default="free", metavar="free|DIR",
                        help="the data with the 20 objects (default: free)")
    parser.add_argument("--store", type=Path, metavar="DIR", help="folder of added objects (default: data/objects)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--engine", choices=list(BATCHES), default=default_engine(),
                        help="engine that tries the grasps (default: %(default)s; mujoco is five times faster; warp "
                             "needs dgrasp[warp])")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")


@dataclass(frozen=True)
class _Task:
    """The job of one process: the labels of one object."""

    hand: str
    model: ObjectModel
    count: int
    seed: int
    config: Config
    file: str
    """Name of the file that keeps the labels until all objects are done."""


def main(arguments: argparse.Namespace) -> int:
    """Make and write the labels; returns the exit code."""
    from dgrasp.pool import cores
    from dgrasp.synthesis.progress import MakingProgress

    tasks, hand = _tasks(arguments)
    files = _files(arguments, len(tasks))
    begin = time.monotonic()
    made, figures = [], {}
    workers = min(arguments.workers or cores(), len(tasks))
    parts = arguments.out.with_suffix(".parts")
    todo = [task for task in tasks if not (parts / task.file).is_file()]
    if len(todo) < len(tasks):
        print(f"{parts}: {len(tasks) - len(todo)} objects are there from an interrupted run", flush=True)
    inertia = which_inertia(np.array_equal(task.model.inertia, np.eye(3)) for task in tasks)
    if todo:
        names = ", ".join(task.model.name for task in todo)
        print(f"making {arguments.number * len(todo)} labels, {arguments.number} per object: {names}; hand "
              f"{hand.model.id}, engine {arguments.engine}, workers {workers}; {INERTIA[inertia]}", flush=True)
    context = multiprocessing.get_context("spawn")
    # Each process writes the shares of its own objects, so there is no need for a lock.
    shares = context.RawArray("d", len(todo))
    shown = MakingProgress([task.model.name for task in todo], shares)
    with ProcessPoolExecutor(workers, context, _begin, (shares,)) as pool:
        try:
            running = {task.file: pool.submit(_make, task, i) for i, task in enumerate(todo)}
            for task in tasks:
                result = shown.result(running[task.file]) if task.file in running else None
                labels, row = _kept(parts / task.file, hand, result)
                made.append(labels)
                figures[task.model.name] = row
                print(_line(task.model.name, len(labels), row), flush=True)
        except BaseException:
            # What the processes have begun is lost, and would take minutes to end.
            for process in multiprocessing.active_children():
                process.terminate()
            raise
        finally:
            shown.close()
            pool.shutdown(cancel_futures=True)
    held = sum(row["held"] for row in figures.values()) / sum(map(len, made))
    best = float(np.mean([row["best_quarter_held"] for row in figures.values()]))
    print(f"{sum(map(len, made))} labels in {time.monotonic() - begin:.0f} s; gt_pd holds {held:.2f} of them, "
          f"{best:.2f} of each object's best quarter by geometry; {INERTIA[inertia]}")
    _write(files, made, arguments, hand, figures, inertia)
    shutil.rmtree(parts)
    return 0


def _line(name: str, count: int, row: dict[str, Any]) -> str:
    """One line about an object's labels."""
    return (f"{name}: {count} labels, {row['held']} hold under gt_pd ({row['found_held']:.2f} before the selection, "
            f"{row['best_quarter_held']:.2f} of the best quarter); penetration {row['penetration_cm3']:.2f} cm3, "
            f"{row['touching']:.1f} parts touch, {row['contacts']:.1f} goal contacts, joints "
            f"{row['diversity_deg']:.0f} deg apart; {row['cpu_s']:.0f} s of CPU")


def _tasks(arguments: argparse.Namespace) -> tuple[list[_Task], NamedHand]:
    """One task per object, and the hand; raises `ConfigError` or `DataError` for bad options."""
    out = arguments.out
    if out.suffix != ".npz" or not out.parent.is_dir():
        raise DataError(f"--out {out}: expected the name of a .npz file in a folder that exists")
    if not 1 <= arguments.number <= MOST_LABELS:
        raise ConfigError(f"--number {arguments.number}: expected 1 to {MOST_LABELS} labels per object")
    if arguments.seed < 0 or (arguments.workers is not None and arguments.workers < 1):
        raise ConfigError(f"--seed {arguments.seed} --workers {arguments.workers}: expected a seed of at least 0, and "
                          "at least one process")
    wanted = list(YCB_NAMES.values()) if arguments.objects == ["all"] else list(dict.fromkeys(arguments.objects))
    found = [find_named(name, arguments.store) for name in wanted]
    config = make_config({"engine": arguments.engine}, "labels make")

    from dgrasp.build import require_engine
    from dgrasp.hand.store import AUTHORS_HAND, open_hand

    data = None if arguments.data == "free" else Path(os.path.expanduser(arguments.data))
    name = arguments.hand or ("free" if data is None else str(data / "hand" / f"{AUTHORS_HAND}.urdf"))
    hand = open_hand(name)
    require_engine(arguments.engine, "--engine")
    models = list({model.name: model for model in (build_named(entry, data, config) for entry in found)}.values())
    same = [hand.model.id, __version__, arguments.number, arguments.seed, arguments.engine]
    return [
        _Task(name, model, arguments.number, arguments.seed, config, _part_name(model, same)) for model in models
    ], hand


def _part_name(model: ObjectModel, same: list[Any]) -> str:
    """File name of an object's labels, with a hash of all that they depend on."""
    digest = hashlib.sha256(f"{model!r} {same}".encode()).hexdigest()
    return f"{model.name}-{digest[:12]}.npz"


def _kept(
    path: Path, hand: NamedHand, made: tuple[list[GraspLabel], dict[str, Any]] | None
) -> tuple[list[GraspLabel], dict[str, Any]]:
    """Labels and figures of one object: written to the file if `made` is given, else read from it."""
    from dgrasp.labels.formats.native import read_native_with_meta, write_native

    if made is None:
        labels, meta = read_native_with_meta(path)
        return labels, meta["provenance"]
    path.parent.mkdir(exist_ok=True)
    write_native(path, made[0], made[1], "of a file that is not finished", hand.model.layout.names)
    return made


def _files(arguments: argparse.Namespace, objects: int) -> list[Path]:
    """The label file, or the files of both splits."""
    total, test, out = objects * arguments.number, arguments.test, arguments.out
    if test == 0:
        return [out]
    if not objects <= test <= total - objects:
        raise ConfigError(f"--test {test}: expected {objects} to {total - objects} of {total} labels, so that both "
                          "files have labels of each object")
    return [out.with_name(f"{out.stem}_{split}.npz") for split in ("train", "test")]


_shares: Any = None
"""In a process of the pool: the share of each object that is done."""


def _begin(shares: Any) -> None:
    """Prepare a process of the pool."""
    # The main process handles Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import torch

    global _shares
    _shares = shares
    torch.set_num_threads(1)


def _make(task: _Task, index: int) -> tuple[list[GraspLabel], dict[str, Any]]:
    """The labels of one object and their figures. index: of its share."""
    from dgrasp.hand.store import open_hand
    from dgrasp.synthesis.making import make_labels

    begin = time.process_time()

    def report(share: float) -> None:
        _shares[index] = share

    labels, row = make_labels(open_hand(task.hand), task.model, task.count, task.seed, task.config, report)
    return labels, {**row, "cpu_s": round(time.process_time() - begin, 1)}


def _write(files: list[Path], made: list[list[GraspLabel]], arguments: argparse.Namespace, hand: NamedHand,
           figures: dict[str, dict[str, Any]], inertia: str) -> None:
    from dgrasp.labels.recorded.making import numbered, split
    from dgrasp.synthesis.making import write_labels

    everything = [label for labels in made for label in labels]
    parts = [numbered(everything)] if len(files) == 1 else split(made, arguments.test, arguments.seed)
    licence = write_labels(dict(zip(files, parts, strict=True)), hand, figures, arguments.data == "free",
                           seed=arguments.seed, engine=arguments.engine, inertia=inertia)
    for path, part in zip(files, parts, strict=True):
        print(f"wrote {path}: {len(part)} labels, {path.stat().st_size} bytes; licence: {licence}")
