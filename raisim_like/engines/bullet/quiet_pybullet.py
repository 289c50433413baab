"""Import PyBullet without the build time that it prints on standard error."""

from __future__ import annotations

import contextlib
import os
import sys


def _import_quietly() -> None:
    sys.stderr.flush()
    saved, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        import pybullet  # noqa: F401
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)


if "pybullet" not in sys.modules:
    # Without a standard error there is nothing to silence.
    with contextlib.suppress(OSError):
        _import_quietly()
import pybullet  # noqa: E402

__all__ = ["pybullet"]
