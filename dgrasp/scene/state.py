"""The `SceneState` of N environments: arrays in one block, which may be shared memory."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from dgrasp.hand.layout import HandLayout
from dgrasp.types import Array, GraspGoal, SceneState

Rows = TypeVar("Rows", SceneState, GraspGoal)


def state_shapes(hand: HandLayout) -> dict[str, tuple[int, ...]]:
    """The shape of each array of a `SceneState`, for one environment with that hand."""
    return {
        "gc": (hand.n_dof,),
        "gv": (hand.n_dof,),
        "R_WH0": (3, 3),
        "wrist_start_W": (3,),
        "R_WH": (3, 3),
        "joints_W": (hand.n_keypoints, 3),
        "R_WO": (3, 3),
        "object_pos_W": (3,),
        "object_linvel_W": (3,),
        "object_angvel_W": (3,),
        "contacts": (hand.n_parts,),
        "contact_impulse": (hand.n_parts,),
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


def state_size(hand: HandLayout) -> int:
    """Number of float64 values per environment."""
    return sum(int(np.prod(shape)) for shape in state_shapes(hand).values())


def state_views(n: int, hand: HandLayout, buffer: Array | None = None) -> SceneState:
    """A `SceneState` of N environments whose arrays are views of one buffer (N * `state_size` float64)."""
    if buffer is None:
        buffer = np.zeros(n * state_size(hand))
    views, offset = {}, 0
    for name, shape in state_shapes(hand).items():
        size = n * int(np.prod(shape))
        views[name] = buffer[offset : offset + size].reshape(n, *shape)
        offset += size
    return SceneState(**views)


def take(arrays: Rows, rows: Array) -> Rows:
    """Copies of the arrays for some environments alone, given by their rows (n,)."""
    return type(arrays)(**{name: values[rows] for name, values in vars(arrays).items()})


def copy_state(source: SceneState, target: SceneState, rows: slice) -> None:
    """Write the state of some environments into their rows of a larger state."""
    for name, values in vars(source).items():
        getattr(target, name)[rows] = values
