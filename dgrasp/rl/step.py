"""What a control step returns, declared once for the learner, the environments and the pools."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dgrasp.types import Array

Layout = dict[str, tuple[tuple[int, ...], Any]]
"""Shape and type of named arrays."""


@dataclass(frozen=True)
class Step:
    """One control step of N environments. The next call overwrites the arrays, which may lie in shared memory.

    observation: (N, O) float32, where an episode ended already the first one of the next episode.
    final_observation: (N, O) float32, the last observation of the episode that just ended, where it broke the one
        before the step that broke it; valid where terminated or truncated.
    reward: (N,) float32. reward_terms: (N, K) float32, weighted, in the order of `VecEnv.reward_terms`.
    terminated, truncated: (N,) bool; a truncated episode ran into its time limit.
    broken: (N,) bool, terminated because the simulation broke.
    """

    observation: Array
    final_observation: Array
    reward: Array
    reward_terms: Array
    terminated: Array
    truncated: Array
    broken: Array

    @staticmethod
    def layout(envs: int, observation: int, terms: int) -> Layout:
        """Shape and type of each array of N environments with O observations and K reward terms."""
        return {
            "observation": ((envs, observation), np.float32),
            "final_observation": ((envs, observation), np.float32),
            "reward": ((envs,), np.float32),
            "reward_terms": ((envs, terms), np.float32),
            "terminated": ((envs,), np.bool_),
            "truncated": ((envs,), np.bool_),
            "broken": ((envs,), np.bool_),
        }

    @classmethod
    def allocate(cls, envs: int, observation: int, terms: int) -> Step:
        """Arrays of zeros."""
        layout = cls.layout(envs, observation, terms)
        return cls(**{name: np.zeros(shape, kind) for name, (shape, kind) in layout.items()})

    def write(self, rows: slice, part: Step) -> None:
        """Copy the step of some environments into their rows."""
        for name, array in vars(part).items():
            getattr(self, name)[rows] = array
