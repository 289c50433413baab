"""The interface of a set of environments that the learner uses; `dgrasp.pool` implements it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from dgrasp.rl.collect import Actor, Incident, Trajectories


class VecEnv(Protocol):
    """N environments with observations of size O, actions of size A and K named reward terms."""

    @property
    def num_envs(self) -> int:
        """N."""

    @property
    def observation_size(self) -> int:
        """O."""

    @property
    def actor_size(self) -> int:
        """How many of the O numbers the actor sees: the first ones."""

    @property
    def action_size(self) -> int:
        """A."""

    @property
    def reward_terms(self) -> tuple[str, ...]:
        """Names of the K reward terms."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each environment in messages: that of its label."""

    def collect(self, actor: Actor, epoch: int, steps: int, advance: Callable[[int], None]) -> Trajectories:
        """Reset all environments and let `actor` act in them for `steps` control steps.

        The result depends only on the actor and on (seed, epoch, environment). advance: called now and then with the
        number of control steps made since its last call. The next call of `collect` overwrites the arrays.
        Environments that took no part or were lost on the way are not `valid`.
        """

    def timing(self) -> dict[str, float]:
        """How the time since the start of the last collection was spent, such as `physics_share`."""

    def drain_events(self) -> list[str]:
        """Messages for the user since the last call, such as unstable episodes."""

    def drain_incidents(self) -> list[Incident]:
        """Episodes in which the simulation broke since the last call."""
