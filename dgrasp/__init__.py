"""D-Grasp on open physics: dynamic grasps from static grasp labels (Christen et al., CVPR 2022)."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

__version__ = "0.1.0"


def load_policy(source: str | Path) -> Any:
    """A trained policy as a function from observations to actions of the Gymnasium environments.

    source: a run directory, a checkpoint, published weights, or "pretrained"; see `dgrasp.gym.load_policy`.
    """
    # By name, as the modules of this package import it.
    return import_module("dgrasp.gym").load_policy(source)
