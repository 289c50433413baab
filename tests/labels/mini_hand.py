"""A physics hand with the joints of a model in MANO's layout, without the time that building its shapes takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dgrasp.hand.builder.urdf_writer import LinkPart, hand_urdf
from dgrasp.hand.mano.model import ManoModel
from dgrasp.hand.mano.skeleton import N_PARTS, PART_PARENT
from raisim_like.shapes import Shape


def write_mini_hand(path: Path, model: ManoModel, limit: float = 1.5) -> Path:
    """A URDF of the mean shape with cubes of 1 cm as collision shapes and all limits at +-limit (rad)."""
    vertices, joints = model.shaped(np.zeros(0))
    parts = [
        LinkPart(
            joints[i] - joints[PART_PARENT[i]] if i else np.zeros(3), np.tile([-limit, limit], (3, 1)),
            (Shape("box", (0.01, 0.01, 0.01)),), 0.02, np.zeros(3), 1e-6 * np.eye(3),
        )
        for i in range(N_PARTS)
    ]  # fmt: skip
    tips = vertices[model.tip_vertices] - joints[[3, 6, 9, 12, 15]]
    path.write_text(hand_urdf("mini", "made up", parts, tips, massless=False))
    return path
