"""Collect what can be shown and stored of an evaluation: meshes to draw, and sequences."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from dgrasp.config.experiment import Config
from dgrasp.data import DataChoice
from dgrasp.eval.meshes import build_bodies
from dgrasp.eval.summary import Result
from dgrasp.export.sequence import StoredSequence
from dgrasp.hand.free.skin import SKIN_FILE
from dgrasp.hand.model import HandModel
from dgrasp.hand.store import AUTHORS_HAND, built_hand, is_built_hand
from dgrasp.hand.surface import mano_of_hand
from dgrasp.pool import PoolSpec
from dgrasp.scene.scene import LOWERED_TOP, TABLE_TOP
from dgrasp.types import EpisodeRecord
from dgrasp.view.meshes import OBJECT_FACES, DisplayMeshes, hand_meshes, hand_shapes, light, object_shapes


def display_meshes(choice: DataChoice, spec: PoolSpec) -> dict[str, DisplayMeshes]:
    """Light meshes of the hand and of each object, and their collision shapes, by object name."""
    hand, shapes, parts = hand_meshes(spec.hand), hand_shapes(spec.hand), spec.hand.layout.names.parts
    return {
        name: DisplayMeshes(spec.hand.chain, parts, hand, light(entry.body, OBJECT_FACES),
                            (*shapes, object_shapes(spec.objects[name])))
        for name, entry in build_bodies(choice, spec.objects).items()
    }  # fmt: skip


def mano_origin(choice: DataChoice, hand: HandModel, config: Config) -> dict[str, Any] | None:
    """Side and betas of a hand made from MANO, and, with `eval.mano`, its root joint (3,) m; None for other hands."""
    folder = choice.hand_urdf.parent
    if is_built_hand(folder):
        meta = built_hand(folder)[2]
        if meta["model_file"] == SKIN_FILE:
            return None
        origin = {"side": meta["side"], "betas": [float(beta) for beta in meta["betas"]]}
    elif hand.id == AUTHORS_HAND:
        origin = {"side": "right", "betas": []}
    else:
        return None
    if config.eval.mano is not None:
        file = Path(os.path.expanduser(config.eval.mano))
        origin["root_joint"] = mano_of_hand(file, hand.offsets, hand.id, origin)[2][0].tolist()
    return origin


def sequences(
    result: Result, records: Sequence[EpisodeRecord], spec: PoolSpec, choice: DataChoice,
    meshes: Mapping[str, DisplayMeshes],
) -> Iterator[StoredSequence]:
    """The sequences of the episodes, without episodes that broke in their first step."""
    about = {
        "method": result.method, "engine": result.engine, "window_s": result.window_s, "code": result.commit,
        "timestep_s": spec.config.physics.timestep, "data": result.data,
        "table": {"top_m": TABLE_TOP, "lowered_m": LOWERED_TOP}, "mano": mano_origin(choice, spec.hand, spec.config),
    }  # fmt: skip
    for record, row in zip(records, result.per_label, strict=True):
        if len(record.gc):
            yield StoredSequence(record, meshes[record.label.object_id], spec.hand.layout.names, {**about, "row": row})
