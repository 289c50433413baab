"""D-Grasp on open physics: dynamic grasps from static grasp labels (Christen et al., CVPR 2022)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dgrasp.version import __version__

if TYPE_CHECKING:
    from pathlib import Path

    from dgrasp.gym import GymPolicy

__all__ = ["__version__", "load_policy"]


def load_policy(source: str | Path) -> GymPolicy:
    """A trained policy as a function from observations to actions of the Gymnasium environments.

    source: a run directory, a checkpoint, a file of `dgrasp publish`, or "pretrained"; see `dgrasp.gym.load_policy`.
    """
    # Imported late: Gymnasium and torch take seconds, and most programs need neither.
    from dgrasp.gym import load_policy

    return load_policy(source)
