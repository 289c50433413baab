"""Grasp labels from DexYCB's recordings (paper, section 4.1, "Data").

The grasp is the first frame in which the object has moved by more than a threshold from where it lay. The approach
starts at the frame from which on the wrist stays within a set distance of the object.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dgrasp.config.names import DISPLACEMENT, START_DISTANCE
from dgrasp.errors import DataError
from dgrasp.hand.mano.model import ManoModel
from dgrasp.labels.load import sha256_of
from dgrasp.labels.recorded.cache import LabelCache
from dgrasp.labels.recorded.dexycb import Calibration, Sequence, Track, find_sequences, read_sequence, read_track
from dgrasp.labels.recorded.making import LabelMaker, numbered
from dgrasp.labels.recorded.mirror import mirror_label
from dgrasp.labels.recorded.skips import Skip
from dgrasp.labels.recorded.surfaces import MIRROR_TOLERANCE
from dgrasp.objects.names import YCB_NAMES
from dgrasp.types import Array, GraspLabel, StartPose

APPROACH = 0.05
"""m that the wrist approaches in grasps of large objects, whose origin is beyond the start's distance at the grasp."""
FAR = 0.4
"""m. A wrist farther from the object's origin than this does not grasp it."""
TRAIN_SHARE = 0.75

_VERSION = 1
"""Counts changes of this module that change its labels; part of the cache's keys."""

LEFT, DAMAGED = "left hand", "damaged or missing file"


@dataclass(frozen=True)
class Options:
    """The options of an import.

    displacement, start_distance: m. split: the share of the sequences to take. seed: of the split. left: MANO's left
    hand, with which left-handed sequences are read before they are mirrored; None leaves them out. left_sha256: of its
    file.
    """

    displacement: float = DISPLACEMENT
    start_distance: float = START_DISTANCE
    split: Literal["train", "test", "all"] = "all"
    seed: int = 1
    left: ManoModel | None = None
    left_sha256: str = ""


@dataclass(frozen=True)
class Imported:
    """The result of an import.

    labels: numbered within each object. skipped: sequence -> reason and detail. sequences: how many were found.
    in_split: how many of them belong to the split. cached: how many labels and reasons came from the cache. flipped:
    how many extrinsics have a tag whose z points into the table.
    """

    labels: list[GraspLabel]
    skipped: dict[str, tuple[str, str]]
    sequences: int
    in_split: int
    cached: int
    flipped: int

    @property
    def no_start(self) -> int:
        """Labels whose approach was not recorded."""
        return sum(label.start is None for label in self.labels)


def find_frames(track: Track, wrists: Array, displacement: float, distance: float) -> tuple[int, int | None]:
    """Frame indices of the grasp and of the start of the approach.

    The start is None if the hand was first seen nearer than `distance`, or if it would be the grasp itself.
    wrists (F, 3) m, camera frame. Raises `Skip` if the sequence gives no grasp.
    """
    seen = np.flatnonzero(track.object_seen)
    if not seen.size:
        raise Skip("object not annotated")
    if not track.hand_seen.any():
        raise Skip("hand not annotated")
    place = track.T_CO[:, :3, 3]
    moved = np.linalg.norm(place - place[seen[0]], axis=1) > displacement
    grasps = np.flatnonzero(moved & track.object_seen & track.hand_seen)
    if not grasps.size:
        late = (moved & track.object_seen).any()
        raise Skip("hand not annotated once the object has moved" if late else "object not moved beyond the threshold")
    grasp = int(grasps[0])
    both = np.flatnonzero(track.object_seen[: grasp + 1] & track.hand_seen[: grasp + 1])
    apart = np.linalg.norm(wrists[both] - place[both], axis=1)
    if apart[-1] > FAR:
        raise Skip("wrist far from the object at the grasp")
    # A large object's origin may be farther from the wrist than `distance` even when it is grasped.
    far = apart > (distance if apart[-1] < distance else apart[-1] + APPROACH)
    last_far = np.flatnonzero(far)
    start = int(both[last_far[-1] + 1]) if last_far.size else None
    return grasp, None if start == grasp else start


def split_sequences(sequences: Iterable[Sequence], split: str, seed: int) -> set[str]:
    """The names of a split's sequences: 75% train and 25% test of each subject. The same seed gives the same split."""
    rng = np.random.default_rng(seed)
    ordered: list[str] = []
    names = sorted(sequence.name for sequence in sequences)
    for subject in sorted({name.split("/")[0] for name in names}):
        own = [name for name in names if name.split("/")[0] == subject]
        ordered += [own[i] for i in rng.permutation(len(own))]
    if split == "all":
        return set(ordered)
    # In any run of sequences, and so for each subject, the share is met to within one.
    train = {name for k, name in enumerate(ordered) if int(TRAIN_SHARE * (k + 1)) > int(TRAIN_SHARE * k)}
    return train if split == "train" else set(ordered) - train


def import_dexycb(
    root: Path, maker: LabelMaker, mano_sha256: str, options: Options, cache: LabelCache,
    progress: Callable[[list[Path]], Iterable[Path]] = iter,
) -> Imported:
    """Labels of the split's sequences below `root`. Sequences that give no label are listed with the reason.

    progress: wraps the list of the split's folders, to show progress.
    """
    skipped: dict[str, tuple[str, str]] = {}
    sequences: dict[Path, Sequence] = {}
    folders = find_sequences(root)
    for folder in folders:
        try:
            sequences[folder] = read_sequence(folder)
        except DataError as error:
            skipped[f"{folder.parent.name}/{folder.name}"] = (DAMAGED, str(error))
    wanted: set[str] = set()
    # Each side is split apart, so that the split of right hands does not depend on whether left ones are mirrored.
    for side in ("right", "left"):
        own = [sequence for sequence in sequences.values() if sequence.side == side]
        if side == "left" and options.left is None:
            skipped |= {sequence.name: (LEFT, "") for sequence in own}
        else:
            wanted |= split_sequences(own, options.split, options.seed)
    calibration, labels, cached = Calibration(Path(root)), [], 0
    for folder in progress([folder for folder, sequence in sequences.items() if sequence.name in wanted]):
        sequence = sequences[folder]
        try:
            calibration.world(sequence.extrinsics)
            key = _key(sequence, calibration, maker, mano_sha256, options)
            found = cache.get(key)
            cached += found is not None
            if found is None:
                found = _extract(sequence, calibration, maker, options)
                cache.put(key, found)
        except DataError as error:
            found = Skip(DAMAGED, str(error))
        if isinstance(found, Skip):
            skipped[sequence.name] = (found.reason, found.detail)
        else:
            labels.append(found)
    return Imported(numbered(labels), skipped, len(folders), len(wanted), cached, len(calibration.flipped))


def _key(
    sequence: Sequence, calibration: Calibration, maker: LabelMaker, mano_sha256: str, options: Options
) -> dict[str, Any]:
    """Everything that a sequence's label depends on."""
    below = calibration.root / "calibration"
    files = [sequence.folder / "pose.npz", sequence.folder / "meta.yml",
             below / f"extrinsics_{sequence.extrinsics}" / "extrinsics.yml",
             below / f"mano_{sequence.mano}" / "mano.yml"]
    return {
        "kind": "dexycb", "version": _VERSION, "name": sequence.name, "files": [sha256_of(file) for file in files],
        "mesh": maker.surfaces.sha256(_object(sequence)), "mano": mano_sha256,
        "left": options.left_sha256 if options.left else "", "hand": maker.hand.id,
        "offsets": maker.hand.offsets.tolist(), "tips": maker.hand.tips.tolist(),
        "displacement": options.displacement, "start_distance": options.start_distance,
    }


def _object(sequence: Sequence) -> str:
    try:
        return YCB_NAMES[sequence.grasped]
    except KeyError:
        raise DataError(f"{sequence.folder}: grasps the object {sequence.grasped}; expected DexYCB ids "
                        f"{', '.join(map(str, YCB_NAMES))}") from None


def _extract(
    sequence: Sequence, calibration: Calibration, maker: LabelMaker, options: Options
) -> GraspLabel | Skip:
    try:
        return _label(sequence, calibration, maker, options)
    except Skip as skip:
        return skip


def _label(sequence: Sequence, calibration: Calibration, maker: LabelMaker, options: Options) -> GraspLabel:
    left = sequence.side == "left"
    model = options.left if left and options.left is not None else maker.model
    betas, T_WC = calibration.betas(sequence.mano), calibration.world(sequence.extrinsics)
    track = read_track(sequence)
    T_CH, hand_pose = track.wrists(model, betas)
    grasp, begin = find_frames(track, T_CH[:, :3, 3], options.displacement, options.start_distance)
    T_WH, T_WO = T_WC @ T_CH, T_WC @ track.T_CO
    name = _object(sequence)
    contacts = maker.contacts(model, betas, np.linalg.inv(T_WO[grasp]) @ T_WH[grasp], hand_pose[grasp], name)
    start = None if begin is None else StartPose(T_WH[begin], T_WO[begin], hand_pose[begin])
    label = maker.label(name, T_WH[grasp], hand_pose[grasp], T_WO[grasp], contacts, start,
                        f"dexycb:{sequence.name}", on_table=True)
    return _mirrored(label, maker) if left else label


def _mirrored(label: GraspLabel, maker: LabelMaker) -> GraspLabel:
    """The label of a left hand for the right one, across the object's own mirror plane."""
    axis, middle, off = maker.surfaces[label.object_id].mirror_plane()
    if off > MIRROR_TOLERANCE:
        raise Skip("object is not its own mirror image", f"{label.object_id}: off by {1000 * off:.1f} mm")
    # The mirror plane is x = c instead of x = 0: a point at x goes to 2 c - x.
    shift = np.zeros(3)
    shift[axis] = 2.0 * middle
    start = label.start
    if start is not None:
        start = dataclasses.replace(start, T_WO=_shifted(start.T_WO, shift))
    moved = dataclasses.replace(label, T_WO=_shifted(label.T_WO, shift), start=start)
    turned = mirror_label(moved, maker.hand.id, axis)
    return maker.label(turned.object_id, turned.T_WH, turned.hand_pose, turned.T_WO, turned.goal_contacts,
                       turned.start, turned.source, turned.on_table)


def _shifted(T: Array, shift_O: Array) -> Array:
    out: Array = T.copy()
    out[:3, 3] += T[:3, :3] @ shift_O
    return out
