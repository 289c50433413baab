"""The `SceneState` of N environments: arrays in one block, which may be shared memory."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from dgrasp.hand.mano.skeleton import N_DOF, N_KEYPOINTS, N_PARTS
from dgrasp.types import Array, GraspGoal, SceneState

_SHAPES: dict[str, tuple[int, ...]] = {
    "gc": (N_DOF,),
    "gv": (N_DOF,),
    "R_WH0": (3, 3),
    "wrist_start_W": (3,),
    "R_WH": (3, 3),
    "joints_W": (N_KEYPOINTS, 3),
    "R_WO": (3, 3),
    "object_pos_W": (3,),
    "object_linvel_W": (3,),
    "object_angvel_W": (3,),
    "contacts": (N_PARTS,),
    "contact_impulse": (N_PARTS,),
    "object_start_W": (3,),
    "table_height_W": (),
    "object_mass": (),
    "table_contact": (),
    "table_gone": (),
    "holding": (),
    "episode_time": (),
    "R_WG": (3, 3),
    "target_pos_W": (3,),
}

Rows = TypeVar("Rows", SceneState, GraspGoal)

STATE_SIZE = sum(int(np.prod(shape)) for shape in _SHAPES.values())
"""float64 numbers per environment."""


def state_views(n: int, buffer: Array | None = None) -> SceneState:
    """A `SceneState` of N environments whose arrays are views of one buffer (N * STATE_SIZE float64)."""
    if buffer is None:
        buffer = np.zeros(n * STATE_SIZE)
    views, offset = {}, 0
    for name, shape in _SHAPES.items():
        size = n * int(np.prod(shape))
        views[name] = buffer[offset : offset + size].reshape(n, *shape)
        offset += size
    return SceneState(**views)


def take(arrays: Rows, rows: Array) -> Rows:
    """The same of some environments alone: copies."""
    return type(arrays)(**{name: values[rows] for name, values in vars(arrays).items()})


def copy_state(source: SceneState, target: SceneState, rows: slice) -> None:
    """Writes a state of some environments into their rows of a larger one."""
    for name in _SHAPES:
        getattr(target, name)[rows] = getattr(source, name)
