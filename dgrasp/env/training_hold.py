"""The test's hold in training episodes (`env.hold`): the table is removed, the wrist held, a drop ends the episode."""

from __future__ import annotations

import numpy as np

from dgrasp.config.sections import EnvConfig
from dgrasp.control.controllers import WristHold
from dgrasp.hand.layout import HandLayout
from dgrasp.types import Array, GraspGoal, SceneState


class TrainingHold:
    """The hold of N environments; not used if `env.hold.first_step` is null. control: holds the wrist."""

    def __init__(self, env: EnvConfig, hand: HandLayout, state: SceneState, n: int) -> None:
        self.config, self.control = env.hold, WristHold(env.action, hand, state)
        self.exists = env.hold.first_step is not None
        self._removal, self._drop_height = np.zeros(n, int), np.zeros(n)
        self._target = np.zeros(state.gc.shape)

    def draw(self, i: int, rng: np.random.Generator) -> None:
        """Draw the step at which the table of environment `i` is removed."""
        if self.config.first_step is not None:
            self._removal[i] = rng.integers(self.config.first_step, self.config.last_step + 1)

    def begin(self, state: SceneState, clock: Array, active: Array) -> Array:
        """Start the hold where it is due; return the rows (n,) of the environments whose table must be removed now.

        clock: (N,) control steps since the start of the episode. active: (N,) bool, see `GraspEnv.active`.
        """
        rows = np.flatnonzero(active & (state.table_gone == 0) & (clock >= self._removal))
        if len(rows):
            self.control.catch(state, rows)
            state.table_gone[rows] = 1.0
            self._drop_height[rows] = state.object_pos_W[rows, 2] - self.config.drop
        return rows

    def aim(self, state: SceneState, goal: GraspGoal, sigma: Array, target: Array) -> Array:
        """Write the PD targets (N, D) of held hands into `target`; return the action scales of all environments."""
        held = state.table_gone > 0
        self.control.bias(state, goal, self._target)
        target[held] = self._target[held]
        return np.where(held[:, None], self.control.sigma, sigma)

    def judge(self, state: SceneState) -> Array:
        """(N,) bool: environments that have dropped the object. Writes those that hold it into `state.holding`."""
        dropped: Array = (state.table_gone > 0) & (state.object_pos_W[:, 2] < self._drop_height)
        np.multiply(state.table_gone, ~dropped, out=state.holding)
        return dropped
