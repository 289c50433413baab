"""Load labels from any file that the project reads, and choose among them."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dgrasp.errors import DataError
from dgrasp.files import licences
from dgrasp.labels.formats import official
from dgrasp.labels.formats.native import read_native_with_meta
from dgrasp.labels.splits import object_set
from dgrasp.objects.names import nearest, resolve_object
from dgrasp.types import GraspLabel

SOURCES = ("dexycb", "grasptta", "contactopt")
SPLITS = ("train", "test")
RELEASE_FILES: dict[tuple[str, str], str] = {
    ("dexycb", "train"): "dexycb_train_labels.pkl",
    ("dexycb", "test"): "dexycb_test_labels.pkl",
    ("grasptta", "train"): "dexycb_grasptta_train.pkl",
    ("grasptta", "test"): "dexycb_grasptta_test.pkl",
    ("contactopt", "train"): "contact_opt_train.pkl",
    ("contactopt", "test"): "contact_opt_test.pkl",
}
"""The label files of the authors' release, by source and split: those that the paper's tables are about."""

_LICENCES = {"dexycb": licences.DEXYCB}


@dataclass(frozen=True)
class LabelSet:
    """The labels of one file.

    labels: in the file's order. hand: id of the hand they were made for. licence: the file's terms.
    source: the file. sha256: of its bytes. published_as: (source, split) for a file of the authors' release,
    else None. comparable_with_paper: whether the paper's tables are about these labels.
    """

    labels: list[GraspLabel]
    hand: str
    licence: str
    source: Path
    sha256: str
    published_as: tuple[str, str] | None
    comparable_with_paper: bool

    @property
    def objects(self) -> list[str]:
        """Names of the objects, in the order of their first label."""
        return list(dict.fromkeys(label.object_id for label in self.labels))


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file's bytes, in hexadecimal."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None


def load_labels(path: Path) -> LabelSet:
    """The labels of `path`; its content, not its name, says which reader it needs.

    Raises `DataError` for a file that is missing, of neither format, or bad.
    """
    path = Path(path)
    if not os.path.isfile(path):
        raise DataError(f"{path}: no such label file; expected a release's .pkl or a .npz written by `dgrasp labels`")
    try:
        with path.open("rb") as stream:
            head = stream.read(4)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    if head.startswith(b"PK"):
        labels, meta = read_native_with_meta(path)
        return LabelSet(labels, meta["hand"], meta["licence"], path, sha256_of(path), None, False)
    if head.startswith(b"\x80"):
        labels = official.read_official(path)
        known = next((key for key, name in RELEASE_FILES.items() if name == path.name), None)
        licence = _LICENCES.get(known[0] if known else "", licences.MANO)
        return LabelSet(labels, official.HAND, licence, path, sha256_of(path), known, known is not None)
    raise DataError(f"{path}: neither a joblib pickle nor a .npz file (it begins with {head!r}); expected a release's "
                    ".pkl or a .npz written by `dgrasp labels`")


def select(labels: LabelSet, objects: Sequence[str] = (), limit_per_object: int | None = None) -> LabelSet:
    """The labels of `objects` (all where empty), of each at most the first `limit_per_object`, order kept.

    Objects are given as `resolve_object` takes them, or as sets (`splits.object_set`). An object that is unknown or has
    no label here is a `DataError` that names the nearest one.
    """
    there = labels.objects
    wanted = set(there)
    if objects:
        wanted = set()
        for name in objects:
            group = object_set(name)
            if group is not None:
                if not group.intersection(there):
                    raise DataError(f"{labels.source}: no label of an object of {name!r}; it has {', '.join(there)}")
                wanted |= group
                continue
            full = name if name in there else resolve_object(name)
            if full not in there:
                raise DataError(f"{labels.source}: no label of {full!r}{nearest(full, there)}; "
                                f"it has {', '.join(there)}")
            wanted.add(full)
    taken: dict[str, int] = dict.fromkeys(there, 0)
    chosen = []
    for label in labels.labels:
        if label.object_id in wanted and (limit_per_object is None or taken[label.object_id] < limit_per_object):
            taken[label.object_id] += 1
            chosen.append(label)
    return dataclasses.replace(labels, labels=chosen)
