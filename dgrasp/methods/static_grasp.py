"""The baseline "Ours+static grasp": once the grasp is there, the fingers only hold while the wrist moves."""

from __future__ import annotations

import numpy as np

from dgrasp.env.grasp_env import Mode
from dgrasp.methods.pd import PdBaseline
from dgrasp.methods.policy import Method
from dgrasp.types import Array


class StaticGrasp:
    """Paper, section 4.1. In the motion the fingers' PD targets stay (`motion.static_fingers`), whatever `grasp` says.

    grasp: what makes the grasp and is tested for stability: a policy, or by default PD in the label's pose.
    """

    name = "static_grasp"

    def __init__(self, grasp: Method | None = None) -> None:
        self.grasp = grasp or PdBaseline()
        self.mode: Mode = self.grasp.mode

    def act(self, observation: Array) -> Array:
        """Actions (N, D) of the grasp."""
        return np.asarray(self.grasp.act(observation))
