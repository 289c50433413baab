"""Coulomb's law for the sliding contacts of MuJoCo (docs/physics.md).

MuJoCo's convex contact law separates two bodies at friction times their sliding speed, so that a sliding block hops.
De Saxcé's correction subtracts that speed from the contact's target normal velocity, between the two halves of each
step. `sliding.c` does so as a callback of MuJoCo, if the package was built with a C compiler; otherwise Python does.
"""

from __future__ import annotations

import ctypes
from typing import Any

import mujoco as mj
import numpy as np

MARK = "sliding contacts stay closed"
"""Name of a number in a model, which tells `sliding.c` to correct the model's contacts."""


def _load() -> Any:
    """The callback of `sliding.c`; None if it was not built, or was built for another version of MuJoCo."""
    try:
        from raisim_like.engines.mujoco import _sliding  # type: ignore[attr-defined]
    except ImportError:
        return None
    if mj.mj_version() != _sliding.MUJOCO_VERSION:
        return None
    return ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(_sliding.ADDRESS)


_CALLBACK = _load()
if _CALLBACK is not None and mj.get_mjcb_control() is None:
    # MuJoCo has one callback for the whole process. Ours leaves models without the mark alone.
    mj.set_mjcb_control(_CALLBACK)


def native() -> bool:
    """Whether MuJoCo itself calls the correction: it was built, and no other code has set another callback."""
    return _CALLBACK is not None and mj.get_mjcb_control() is _CALLBACK


def advance(model: mj.MjModel, data: mj.MjData, steps: int) -> None:
    """Make some steps with sliding contacts kept closed. A world that breaks computes with NaN."""
    if native():
        # This runs without the interpreter's lock, so that threads can advance several worlds at once.
        mj.mj_step(model, data, nstep=steps)
        return
    with np.errstate(all="ignore"):
        for _ in range(steps):
            mj.mj_step1(model, data)
            keep_closed(model, data)
            mj.mj_step2(model, data)


def keep_closed(model: mj.MjModel, data: mj.MjData) -> None:
    """Correct the contacts of the coming step."""
    contact = data.contact
    rows = contact.efc_address
    # Points on the edge of the margin have no force, and no row.
    acting = rows >= 0
    rows = rows[acting]
    # The rows of a contact are the normal and two tangents, and more with rolling friction.
    speed = np.hypot(data.efc_vel[rows + 1], data.efc_vel[rows + 2])
    data.efc_aref[rows] -= contact.friction[acting, 0] * speed / model.opt.timestep
