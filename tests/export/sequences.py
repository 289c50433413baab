"""A stored sequence made by hand: two boxes for a palm and a thumb, a box for an object, an episode of 8 steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from dgrasp.export.sequence import StoredSequence
from dgrasp.hand.mano.layout import MANO_NAMES, mano_kinematics
from dgrasp.hand.mano.skeleton import N_PARTS, PARTS
from dgrasp.types import Array, EpisodeRecord
from dgrasp.view.meshes import DisplayMeshes, Mesh
from raisim_like.rotations import matrix_from_euler, transform
from tests.eval.records import DT, label

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
SIDES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
    [1, 5, 7], [1, 7, 3],
])  # fmt: skip
STEPS, START = 8, 3


def box(x: float, y: float, z: float) -> Mesh:
    """A box of these half lengths, m."""
    return Mesh(CUBE * [x, y, z], SIDES)


def meshes() -> DisplayMeshes:
    """A palm and a thumb's last part; the other parts have no shape. The object collides as a box twice as wide."""
    none = Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    hand = [none] * N_PARTS
    hand[0], hand[15] = box(0.05, 0.015, 0.04), box(0.015, 0.008, 0.008)
    offsets = np.zeros((N_PARTS, 3))
    offsets[1:, 0] = -0.03
    shapes = (*hand, box(0.04, 0.05, 0.03))
    return DisplayMeshes(mano_kinematics(offsets), PARTS, tuple(hand), box(0.02, 0.05, 0.03), shapes)


def episode(**changes: Any) -> EpisodeRecord:
    """The wrist turns by 0.3 rad per step about z, past half a turn; the object sinks by 1 cm per step."""
    rng = np.random.default_rng(5)
    gc = rng.uniform(-0.5, 0.5, (STEPS, 51))
    T_WH: Array = np.stack([transform(matrix_from_euler(np.array([0.2, 0.0, 2.2 + 0.3 * k])), np.array([0.5, 0.1, 0.7]))
                            for k in range(STEPS)])
    T_WO = np.stack([transform(matrix_from_euler(np.array([0.1 * k, 0.0, 0.0])), np.array([0.5, 0.0, 0.6 - 0.01 * k]))
                     for k in range(STEPS)])
    contacts = np.zeros((STEPS, 16))
    contacts[2:, [0, 15]] = 1.0
    values: dict[str, Any] = {
        "label": label(), "gc": gc, "T_WH": T_WH, "joints_W": rng.uniform(0.4, 0.6, (STEPS, 21, 3)), "T_WO": T_WO,
        "contacts": contacts, "contact_impulse": 0.00222 * 3.0 * contacts, "table_contact": np.arange(STEPS) < START,
        "reward": np.zeros(STEPS), "window_start": START, "dt": DT,
    }  # fmt: skip
    return EpisodeRecord(**{**values, **changes})


def sequence(mano: dict[str, Any] | None = None, **changes: Any) -> StoredSequence:
    """The episode with the other contents of a stored sequence."""
    about = {
        "method": "gt_pd", "engine": "pybullet", "window_s": 5 * DT, "timestep_s": 0.00222, "code": "test",
        "data": {"labels": "free_train.npz", "licence": "MIT", "inertia": "true"},
        "table": {"top_m": 0.5, "lowered_m": 0.25},
        "row": {"object": "004_sugar_box", "index": 0, "success": True}, "mano": mano,
    }  # fmt: skip
    return StoredSequence(episode(**changes), meshes(), MANO_NAMES, about)
