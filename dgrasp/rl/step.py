"""The result of a control step, declared once for the learner, the environments and the pools."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dgrasp.types import Array

Layout = dict[str, tuple[tuple[int, ...], Any]]
"""Shapes and types of arrays, by name."""


@dataclass(frozen=True)
class Step:
    """One control step of N environments. The next step overwrites the arrays, which may lie in shared memory.

    observation: (N, O) float32; where an episode ended, the first observation of the next episode.
    final_observation: (N, O) float32, valid where terminated or truncated: the last observation of the episode that
        just ended. Where the simulation broke, it is the observation before that step.
    reward: (N,) float32. reward_terms: (N, K) float32, weighted, in the order of `VecEnv.reward_terms`.
    terminated, truncated: (N,) bool; a truncated episode reached its time limit.
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
        """Shape and type of each array for N environments with O observations and K reward terms."""
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
        """Copy the step `part` of some environments into their rows."""
        for name, array in vars(part).items():
            getattr(self, name)[rows] = array
