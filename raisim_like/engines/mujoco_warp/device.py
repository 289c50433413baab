"""Where MuJoCo Warp computes: on a GPU if Warp finds one, else on the processor."""

from __future__ import annotations

import sys
from functools import cache

import warp as wp


@cache
def device() -> wp.Device:
    """The device of all worlds. The first call prints a warning if it is the processor."""
    # Warp would print its version, and a line for each kernel that it loads.
    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    wp.init()
    chosen = wp.get_preferred_device()
    if not chosen.is_cuda:
        print(
            "MuJoCo Warp: no CUDA device was found, so the worlds run on the processor, which is for tests. "
            "engine=mujoco is several times faster there. The first start compiles for about a minute.",
            file=sys.stderr,
        )
    return chosen
