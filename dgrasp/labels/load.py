"""Load labels from any file that the project reads, and select some of them."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from dgrasp.errors import DataError
from dgrasp.files import licences, pickles
from dgrasp.hand.layout import HandNames
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.hand.store import AUTHORS_HAND
from dgrasp.labels.formats import release
from dgrasp.labels.formats.native import names_of, read_native_with_meta
from dgrasp.labels.sources import SOURCES, sources_in
from dgrasp.labels.splits import object_set
from dgrasp.objects.names import resolve_object
from dgrasp.types import GraspLabel


class FileContent(NamedTuple):
    """The content of a label file: labels in its order, the hand's id and names, and the licence if it states one."""

    labels: list[GraspLabel]
    hand: str
    names: HandNames
    licence: str | None


@dataclass(frozen=True)
class LabelFormat:
    """A format of label files.

    head: the first bytes of its files, or several alternatives. name, expected: how messages name such a file, and how
    they ask for one.
    """

    head: bytes | tuple[bytes, ...]
    name: str
    expected: str
    read: Callable[[Path], FileContent]


def _read_pickle(path: Path) -> FileContent:
    return FileContent(release.read_release(path), AUTHORS_HAND, MANO_NAMES, None)


def _read_npz(path: Path) -> FileContent:
    labels, meta = read_native_with_meta(path)
    return FileContent(labels, meta["hand"], names_of(meta), meta["licence"])


FORMATS = (
    LabelFormat(pickles.HEADS, "a joblib pickle", "a .pkl of the authors' release", _read_pickle),
    LabelFormat(b"PK", "a .npz file", "a .npz written by `dgrasp labels`", _read_npz),
)
"""The formats that are read. A file's content, not its name, determines its format."""


@dataclass(frozen=True)
class LabelSet:
    """The labels of one file.

    labels: in the file's order. hand: id of the hand that they were made for. names: the joints, parts and key points
    in the order of the arrays. licence: the file's terms. path: the file. sha256: of its bytes. released_as:
    (source, split) for a file of the authors' release, else None. comparable_with_paper: whether the paper's tables
    report on these labels.
    """

    labels: list[GraspLabel]
    hand: str
    names: HandNames
    licence: str
    path: Path
    sha256: str
    released_as: tuple[str, str] | None
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
    """Load the labels of `path`, in any of `FORMATS`.

    Raises `DataError` for a file that is missing, damaged, or in no such format.
    """
    path, expected = Path(path), " or ".join(form.expected for form in FORMATS)
    if not os.path.isfile(path):
        raise DataError(f"{path}: no such label file; expected {expected}")
    try:
        with path.open("rb") as stream:
            head = stream.read(32)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    form = next((form for form in FORMATS if head.startswith(form.head)), None)
    if form is None:
        formats = " nor ".join(form.name for form in FORMATS)
        raise DataError(f"{path}: neither {formats} (it begins with {head[:4]!r}); expected {expected}")
    labels, hand, names, licence = form.read(path)
    # The files of the release do not state their source; their names tell it.
    known = released_as(path.name) if licence is None else None
    source = SOURCES[known[0]] if known else None
    if licence is None:
        licence = source.licence if source else licences.MANO
    comparable = source is not None and source.comparable_with_paper
    return LabelSet(labels, hand, names, licence, path, sha256_of(path), known, comparable)


def released_as(name: str) -> tuple[str, str] | None:
    """(source, split) of a file of the authors' release, by the file's name; None for other names."""
    released = sources_in("release").values()
    return {file: (source.name, split) for source in released for split, file in source.files.items()}.get(name)


def select(
    labels: LabelSet, objects: Sequence[str] = (), limit_per_object: int | None = None,
    added: Mapping[str, Path] | None = None,
) -> LabelSet:
    """Select the labels of `objects` (all if empty), at most the first `limit_per_object` of each, in their order.

    Objects are given as `resolve_object` takes them, or as sets (`splits.object_set`). added: those of `objects` that
    the user added, with the folder that holds theirs. Raises `DataError` if an object is unknown or has no label here.
    """
    there, added = labels.objects, added or {}
    wanted = set(there)
    if objects:
        wanted = set()
        for name in objects:
            group = object_set(name)
            if group is not None:
                if not group.intersection(there):
                    raise DataError(f"{labels.path}: no label of an object of {name!r}; it has {', '.join(there)}")
                wanted |= group
                continue
            full = name if name in there or name in added else resolve_object(name)
            if full not in there:
                known = "an object that was added" if name in added else "one of the 20 objects"
                words = ["dgrasp", "labels", "make", "--objects", full, "--number", "25", "--out", f"{full}.npz"]
                words += ["--store", str(added[name])] if name in added else []
                raise DataError(f"{labels.path}: no label of {full!r}, {known}; it has {', '.join(there)}; choose "
                                f"one of these, or make labels with `{shlex.join(words)}`")
            wanted.add(full)
    taken: dict[str, int] = dict.fromkeys(there, 0)
    chosen = []
    for label in labels.labels:
        if label.object_id in wanted and (limit_per_object is None or taken[label.object_id] < limit_per_object):
            taken[label.object_id] += 1
            chosen.append(label)
    return dataclasses.replace(labels, labels=chosen)
