"""The baseline *+PD: hand and object start in the label's pose without a table, and PD control holds the pose."""

from __future__ import annotations

import numpy as np

from dgrasp.methods.method import Method
from dgrasp.types import Array


class PdBaseline(Method):
    """*+PD (supplement, section B.4). The environment's mode "label" holds the pose, so all actions are zero."""

    name = "gt_pd"
    mode = "label"
    motion = "never"

    @classmethod
    def make(cls, policy: Method | None, where: str) -> Method:
        """Make the baseline, which takes no policy."""
        return cls()

    def act(self, observation: Array) -> Array:
        """Zeros (N, 1), which broadcast to all joints."""
        return np.zeros((len(observation), 1), np.float32)
