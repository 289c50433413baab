"""Make labels from recorded or computed hands: angles, wrist and contacts for one physics hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dgrasp.errors import DataError
from dgrasp.hand.mano.model import ManoModel, Side
from dgrasp.hand.mano.params import hand_vertices
from dgrasp.hand.mano.skeleton import N_PARTS, PART_PARENT
from dgrasp.hand.model import HandModel
from dgrasp.hand.store import open_hand
from dgrasp.hand.surface import SAME_JOINTS
from dgrasp.labels.recorded.surfaces import Surfaces
from dgrasp.types import Array, GraspLabel, StartPose


@dataclass(frozen=True, eq=False)
class LabelMaker:
    """Makes labels for `hand` from hands that `model` skins."""

    hand: HandModel
    model: ManoModel
    surfaces: Surfaces

    @property
    def owner(self) -> Array:
        """(V,) index of the part that each vertex moves with: the largest skinning weight (supplement, section B.1)."""
        return np.asarray(self.model.part_weights().argmax(axis=1))

    def contacts(self, model: ManoModel, betas: Array, T_OH: Array, hand_pose: Array, name: str) -> Array:
        """(16,) bool: the parts of one hand of shape betas (S,) with a vertex within 0.015 m of the object."""
        vertices, _ = hand_vertices(model, betas[None], T_OH[None], hand_pose[None])
        return self.surfaces[name].near_parts(vertices[0], self.owner)

    def label(
        self, name: str, T_WH: Array, hand_pose: Array, T_WO: Array, contacts: Array, start: StartPose | None,
        source: str, on_table: bool,
    ) -> GraspLabel:
        """A label with the key points of the physics hand and index 0; see `numbered`."""
        joints = self.hand.keypoints_at(T_WH[None], hand_pose[None])[0]
        return GraspLabel(name, hand_pose, T_WH, T_WO, joints, contacts, start, self.hand.id, source, 0, on_table)


def target_hand(name: str, model: ManoModel) -> HandModel:
    """The physics hand for which labels are made. It must have the model's side and joints, else `DataError`.

    name: a folder written by `dgrasp hand build`, or the URDF of the authors' hand (mean shape, right).
    """
    named = open_hand(name)
    side: Side = named.meta.get("side", "right")
    if side != model.side:
        raise DataError(f"--hand {name}: a {side} hand, but the MANO file is of a {model.side} one; give a hand of "
                        "that side, or the other file")
    _, joints = model.shaped(np.array(named.meta.get("betas", []), dtype=float))
    offsets = np.array([joints[i] - joints[PART_PARENT[i]] for i in range(1, N_PARTS)])
    off = float(np.linalg.norm(offsets - named.model.offsets[1:], axis=1).max())
    if off > SAME_JOINTS:
        raise DataError(f"--hand {name}: its joints lie up to {1000 * off:.1f} mm from those of the MANO file; "
                        "expected a hand that was made from it (`dgrasp hand build`, or the authors' mano_mean.urdf)")
    return named.model


def numbered(labels: list[GraspLabel]) -> list[GraspLabel]:
    """The labels by object, in the order of the objects' names, each with its index within its object."""
    counts: dict[str, int] = {}
    out = []
    for label in sorted(labels, key=lambda one: one.object_id):
        index = counts.get(label.object_id, 0)
        counts[label.object_id] = index + 1
        out.append(replace(label, index=index))
    return out


def split(labels: list[list[GraspLabel]], n_test: int, seed: int) -> tuple[list[GraspLabel], list[GraspLabel]]:
    """Train and test labels of equally long lists, one list per object, each split in the same proportion."""
    share, extra = divmod(n_test, len(labels))
    more = set(np.random.default_rng([seed, 0]).permutation(len(labels))[:extra].tolist())
    train: list[GraspLabel] = []
    test: list[GraspLabel] = []
    for k, mine in enumerate(labels):
        cut = share + (k in more)
        test += [replace(label, index=i) for i, label in enumerate(mine[:cut])]
        train += [replace(label, index=i) for i, label in enumerate(mine[cut:])]
    return train, test
