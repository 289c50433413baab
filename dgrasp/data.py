"""Find the hand, objects and labels of an experiment, and describe the choice to the user.

Order of search: the config's `data` (a folder, or "free"); the environment variable DGRASP_DATA; DEX_YCB_DIR, if it is
laid out like the authors' release; a folder with this layout under data/; the free set that ships with the package.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dgrasp.config.experiment import Config
from dgrasp.config.sections import INERTIA, Inertia, LabelsConfig, which_inertia
from dgrasp.errors import DataError
from dgrasp.files.paths import data_root, user_data_root
from dgrasp.hand.store import AUTHORS_HAND, FREE_HAND, FREE_URDF, HandSource, authors_source, find_hand, free_source
from dgrasp.labels.load import LabelSet, load_labels, select, sha256_of
from dgrasp.labels.sources import SOURCES, DataKind, sources_in
from dgrasp.objects.names import YCB_NAMES, nearest
from dgrasp.objects.store import StoredObject, default_store, find_object, is_added

_HAND_FILES: dict[DataKind, str] = {"release": f"{AUTHORS_HAND}.urdf", "free": FREE_URDF.name}
_HAND_IDS: dict[DataKind, str] = {"release": AUTHORS_HAND, "free": FREE_HAND}
_DEFAULT_SOURCE: str = LabelsConfig.model_fields["source"].default
_LAYOUT = f"a folder laid out like the authors' release (hand/{AUTHORS_HAND}.urdf, objects/NAME/*.obj, labels/*.pkl)"


@dataclass(frozen=True)
class DataChoice:
    """The data that an experiment uses.

    root: the data folder.
    kind: "release" (laid out like the authors' release) or "free".
    hand_source: where the hand comes from. hand_sha256: hash of its URDF file.
    objects_dir: folder of object meshes.
    labels: the chosen labels.
    licence: the licence of the labels.
    source, split: the names of source and split ("file" for a label file outside the release).
    inertia: of the objects (`physics.official_compat`): "true"; "official", the authors' 1 kg m^2; or "mixed", true for
    added objects alone.
    differences: in what hand, labels and inertia differ from the paper's.
    notes: remarks on how the data was found.
    added: name -> object, for those of the labels' objects that are not among the 20 but were added by the user.
    """

    root: Path
    kind: DataKind
    hand_source: HandSource
    hand_sha256: str
    objects_dir: Path
    labels: LabelSet
    licence: str
    source: str
    split: str
    inertia: Inertia
    differences: tuple[str, ...]
    notes: tuple[str, ...] = ()
    added: dict[str, StoredObject] = field(default_factory=dict)

    @property
    def hand_urdf(self) -> Path:
        """The hand's file."""
        return self.hand_source.urdf

    @property
    def hand(self) -> str:
        """The hand's id."""
        return self.hand_source.id

    @property
    def comparable_with_paper(self) -> bool:
        """Whether hand, labels and inertia are the paper's."""
        return not self.differences

    def inertia_of(self, name: str) -> Inertia:
        """The inertia of one object: "true" or "official"."""
        if self.inertia == "mixed":
            return "true" if name in self.added else "official"
        return self.inertia

    def stamp(self) -> dict[str, Any]:
        """Record of the choice for results and run folders: plain JSON values, without paths of this machine."""
        added = {"added_objects": {name: entry.id for name, entry in self.added.items()}} if self.added else {}
        return {
            "kind": self.kind,
            "hand": self.hand,
            "labels": self.labels.path.name,
            "source": self.source,
            "split": self.split,
            "n_labels": len(self.labels.labels),
            "n_objects": len(self.labels.objects),
            "licence": self.licence,
            "hand_file": self.hand_urdf.name,
            "hand_sha256": self.hand_sha256,
            "labels_sha256": self.labels.sha256,
            "inertia": self.inertia,
            "comparable_with_paper": self.comparable_with_paper,
            **added,
        }

    def describe(self) -> str:
        """One line: data folder, hand, labels, their number, licence, inertia of the objects, and notes."""
        which = f"{self.source} {self.split}" if self.source != "file" else "a file's"
        line = (f"data {self.kind} ({self.root}): hand {self.hand}, {which} labels ({self.labels.path.name}), "
                f"{len(self.labels.labels)} of {len(self.labels.objects)} objects; licence: {self.licence}")
        added = [f"{len(self.added)} of them added: {', '.join(self.added)}"] if self.added else []
        return "; ".join([line, *added, INERTIA[self.inertia], *self.notes])


def resolve(config: Config) -> DataChoice:
    """Find the data of an experiment.

    Raises `DataError` if something that the config names does not exist (the message lists what was looked for and what
    was found), if the labels were made for another hand, and, with `fallback: error`, if only the free set is found.
    """
    root, notes = find_root(config)
    kind: DataKind = "free" if _is_free(root) else "release"
    if kind == "release" and not os.path.isdir(root / "objects"):
        raise DataError(f"{root}: no folder objects/; expected {_LAYOUT}")
    source_of_hand = _hand(config, root, kind)
    hand_urdf, hand = source_of_hand.urdf, source_of_hand.id
    path, named = _label_file(config, root, kind)
    labels = load_labels(path)
    source, split = named or labels.released_as or ("file", "file")
    if labels.hand != hand:
        raise DataError(f"{path}: labels made for the hand {labels.hand!r}, but the hand of {root} is {hand!r}; "
                        "a grasp fits only its own hand; choose data and labels that go together (--data, --labels, "
                        "hand=)")
    folders = _object_folders(config, root)
    homes = {name: [folder for folder in folders if is_added(name, [folder])] for name in config.labels.objects}
    own = {name: found[0] for name, found in homes.items() if found}
    chosen = select(labels, config.labels.objects, config.labels.limit_per_object, own)
    added = {name: find_object(name, folders) for name in chosen.objects if name not in YCB_NAMES.values()}
    differences = []
    if kind != "release" or hand_urdf != root / "hand" / _HAND_FILES[kind]:
        differences.append(f"the hand is {hand}, not the paper's")
    if not labels.comparable_with_paper:
        differences.append(f"the labels ({path.name}) are not the paper's")
    inertia = _inertia(config, kind, chosen.objects, added)
    if inertia != "official":
        which = "added" if inertia == "mixed" else "the"
        differences.append(f"{which} objects have true inertia, not the authors' 1 kg m2")
    return DataChoice(
        root=root, kind=kind, hand_source=source_of_hand, hand_sha256=sha256_of(hand_urdf),
        objects_dir=root / "objects", labels=chosen, added=added,
        licence=labels.licence, source=source, split=split, inertia=inertia, differences=tuple(differences),
        notes=tuple(notes),
    )


def _inertia(config: Config, kind: DataKind, objects: Sequence[str], added: Mapping[str, StoredObject]) -> Inertia:
    return which_inertia(config.physics.authors_inertia(kind == "release" and name not in added) for name in objects)


def _object_folders(config: Config, root: Path) -> list[Path]:
    """The folders with added objects: the one that the config names, else the data's and the user's."""
    if config.objects is None:
        return [root / "objects", default_store()]
    folder = Path(os.path.expanduser(config.objects))
    if not os.path.isdir(folder):
        raise DataError(f"objects: no folder {str(folder)!r}; expected one that `dgrasp object add` wrote to")
    return [folder]


def _is_free(folder: Path) -> bool:
    return os.path.isfile(folder / "hand" / _HAND_FILES["free"])


def _is_release(folder: Path) -> bool:
    return os.path.isdir(folder / "labels") and not _is_free(folder)


def _holds_recordings(folder: Path) -> bool:
    """Whether the folder holds DexYCB's recordings: subject/sequence/meta.yml."""
    try:
        return next(folder.glob("*/*/meta.yml"), None) is not None
    except OSError:
        return False


def _contents(folder: Path) -> str:
    try:
        names = sorted(p.name + "/" * p.is_dir() for p in folder.iterdir())
    except OSError as error:
        return error.strerror or str(error)
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "") or "nothing"


def find_root(config: Config) -> tuple[Path, list[str]]:
    """The data folder, and notes for the user; `DataError` if there is none."""
    if config.data is not None:
        return _named_root(config.data, "data"), []
    if os.environ.get("DGRASP_DATA"):
        return _named_root(os.environ["DGRASP_DATA"], "DGRASP_DATA"), ["from DGRASP_DATA"]
    looked = ["config key data (not set)", "DGRASP_DATA (not set)"]
    notes: list[str] = []
    candidates = []
    if os.environ.get("DEX_YCB_DIR"):
        candidates.append(("DEX_YCB_DIR", Path(os.path.expanduser(os.environ["DEX_YCB_DIR"]))))
    else:
        looked.append("DEX_YCB_DIR (not set)")
    here = user_data_root()
    others = sorted(p for p in here.iterdir() if p.name not in ("free", "dexycb")) if os.path.isdir(here) else []
    candidates += [("data", folder) for folder in (here / "dexycb", *others)]
    for name, folder in candidates:
        if _is_release(folder):
            return folder, notes + ([f"from {name}"] if name != "data" else [])
        if _holds_recordings(folder):
            notes.append(f"{folder} ({name}) holds DexYCB's raw recordings, which are not read directly; "
                         "`dgrasp labels import dexycb` makes labels from them")
            looked.append(f"{folder} ({name}: raw recordings, which are not read directly)")
        elif name != "data" or folder.name == "dexycb":
            looked.append(f"{folder} ({name}: " + ("no labels/ in it)" if os.path.isdir(folder) else "no such folder)"))
    if config.fallback == "error":
        raise DataError(f"no data found and `fallback: error` forbids the free set; looked at {', '.join(looked)}; and "
                        f"at every folder in {here} for labels/; expected {_LAYOUT}; name it with --data, or choose "
                        "--data free")
    return _named_root("free", "data"), notes


def _named_root(name: str, origin: str) -> Path:
    """The folder `name` ("free": the shipped set). Raises `DataError`, naming `origin`, if it holds no usable data."""
    folder = data_root() / "free" if name == "free" else Path(os.path.expanduser(name))
    if not name or not os.path.isdir(folder):
        raise DataError(f"{origin}: no folder {str(folder)!r}; expected \"free\" or {_LAYOUT}")
    if not (_is_free(folder) or _is_release(folder)):
        raw = _holds_recordings(folder)
        held = "DexYCB's raw recordings, which are not read directly" if raw else _contents(folder)
        raise DataError(f"{origin}: {folder} has no labels/; it holds {held}; expected {_LAYOUT}")
    return folder


def _hand(config: Config, root: Path, kind: DataKind) -> HandSource:
    """The data's own hand, or the hand that the config names (an id, a URDF file, a built hand's folder)."""
    default, own = root / "hand" / _HAND_FILES[kind], _HAND_IDS[kind]
    if config.hand is not None and config.hand != own:
        found = find_hand(config.hand)
        if found is None:
            raise DataError(f"hand: neither the hand of {root} ({own!r}) nor a file: {config.hand!r}; expected "
                            "that name, a URDF file, or a folder of `dgrasp hand build`; or give other data (--data)")
        return found
    if not os.path.isfile(default):
        raise DataError(f"{default}: no such hand; in its folder: {_contents(default.parent)}; expected "
                        f"{_LAYOUT}")
    return free_source(default) if kind == "free" else authors_source(default)


def _label_file(config: Config, root: Path, kind: DataKind) -> tuple[Path, tuple[str, str] | None]:
    """The label file, and (source, split), or None if the config names a file."""
    source, split, folder = config.labels.source, config.labels.split, root / "labels"
    there = sources_in(kind)
    # Where the default source is not, the default means the data's own labels: in the free set, the free ones.
    named = there | {_DEFAULT_SOURCE: there.get(_DEFAULT_SOURCE) or next(iter(there.values()))}
    if source in named:
        chosen = named[source]
        path = folder / chosen.files.get(split, "")
        if os.path.isfile(path):
            return path, (chosen.name, split)
        files = {f"{key} {t}": name for key, one in there.items() for t, name in one.files.items()}
        splits = [text for text, name in files.items() if os.path.isfile(folder / name)]
        raise DataError(f"{path}: no {split} split of {chosen.name} labels here; expected one of the splits that are "
                        f"there: {', '.join(splits) or 'none'}")
    if source in SOURCES:
        here, elsewhere = ("the free set", f"--data with {_LAYOUT}") if kind == "free" else (str(root), "--data free")
        raise DataError(f"labels.source: {here} has no labels of {source}; expected {', '.join(there)}, or {elsewhere}")
    for path in (Path(os.path.expanduser(source)), folder / source):
        if source and os.path.isfile(path):
            return path, None
    raise DataError(f"labels.source: {source!r} is neither {', '.join(there)} nor a file (here or in {folder})"
                    f"{nearest(source, there)}")
