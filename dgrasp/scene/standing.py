"""Place labels without a table onto the table: GraspTTA and ContactOpt give hand and object somewhere in space."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from dgrasp.geometry.shape_mesh import shapes_vertices
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.types import Array, GraspLabel, StartPose

PLACE_XY = (0.6, 0.0)
"""m. Where on the table the object's origin is placed."""


def standing(labels: Sequence[GraspLabel], objects: Mapping[str, ObjectModel]) -> list[GraspLabel]:
    """The labels; those without a table are shifted so that their object's lowest point touches the table's top.

    Hand, object and start move together and nothing turns (supplement, B.5: "we place the object on a surface").
    """
    vertices: dict[str, Array] = {}
    placed = []
    for label in labels:
        if label.on_table:
            placed.append(label)
            continue
        name = label.object_id
        if name not in vertices:
            vertices[name] = shapes_vertices(objects[name].shapes)
        lowest = float((vertices[name] @ label.T_WO[2, :3]).min())
        shift = np.array([*PLACE_XY, TABLE_TOP - lowest]) - label.T_WO[:3, 3]
        start = label.start
        if start is not None:
            start = StartPose(_shifted(start.T_WH, shift), _shifted(start.T_WO, shift), start.hand_pose)
        placed.append(dataclasses.replace(
            label, T_WH=_shifted(label.T_WH, shift), T_WO=_shifted(label.T_WO, shift),
            joints_W=label.joints_W + shift, start=start,
        ))  # fmt: skip
    return placed


def _shifted(T: Array, shift: Array) -> Array:
    out: Array = T.copy()
    out[:3, 3] += shift
    return out
