"""What the learner needs of a set of environments; `dgrasp.pool` implements it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from dgrasp.rl.collect import Actor, Incident, Trajectories


class VecEnv(Protocol):
    """N environments, with O observations, A actions and K named reward terms."""

    @property
    def num_envs(self) -> int:
        """N."""

    @property
    def observation_size(self) -> int:
        """O."""

    @property
    def actor_size(self) -> int:
        """How many of the observations, from the first, the actor sees."""

    @property
    def action_size(self) -> int:
        """A."""

    @property
    def reward_terms(self) -> tuple[str, ...]:
        """Names of the K reward terms."""

    @property
    def names(self) -> tuple[str, ...]:
        """What to call each environment in messages: its label."""

    def collect(self, actor: Actor, epoch: int, steps: int, advance: Callable[[int], None]) -> Trajectories:
        """`steps` control steps of all environments from a reset, acted on by `actor`.

        What happens depends on the actor and (seed, epoch, environment) alone. `advance` is told now and then
        how many control steps have been made since it was last told. The next call overwrites the arrays.
        Environments that took no part, or were lost on the way, are not `valid`.
        """

    def timing(self) -> dict[str, float]:
        """How the time since the last collection began was spent, such as `physics_share`."""

    def drain_events(self) -> list[str]:
        """What happened since the last call that a person should read, such as unstable episodes."""

    def drain_incidents(self) -> list[Incident]:
        """Episodes that the simulation broke since the last call."""
