"""The meshes of the chosen data, used to measure interpenetration and to correct labels."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from dgrasp.config.experiment import Config
from dgrasp.data import DataChoice
from dgrasp.eval.interpenetration import Interpenetration
from dgrasp.hand.model import HandModel
from dgrasp.hand.store import built_hand, is_built_hand
from dgrasp.hand.surface import hand_surface
from dgrasp.objects.body import ObjectBody, object_body
from dgrasp.objects.model import ObjectModel


def build_bodies(choice: DataChoice, objects: Mapping[str, ObjectModel]) -> dict[str, ObjectBody]:
    """The surfaces of the objects by name, for measurements on meshes."""
    return {name: object_body(model, choice.objects_dir) for name, model in objects.items()}


def build_interpenetration(
    choice: DataChoice, config: Config, hand: HandModel, bodies: Mapping[str, ObjectBody]
) -> Interpenetration:
    """The `Interpenetration` that measures on the best available surface of the chosen hand."""
    folder = choice.hand_urdf.parent
    meta = built_hand(folder)[2] if is_built_hand(folder) else {}
    mano = None if config.eval.mano is None else Path(os.path.expanduser(config.eval.mano))
    return Interpenetration(hand_surface(hand, mano, meta), bodies)
