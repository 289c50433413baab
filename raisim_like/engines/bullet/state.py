"""Snapshots of PyBullet worlds."""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from raisim_like.engines.bullet.pd import ImplicitPd
from raisim_like.engines.bullet.quiet_pybullet import pybullet as p
from raisim_like.engines.pending import Pending
from raisim_like.engines.protocol import Array


class BulletSnapshot:
    """Bullet's own state, which the client keeps until this object is deleted, and the controllers' arrays."""

    def __init__(
        self, client: int, bodies: set[int], systems: Mapping[int, ImplicitPd], block: tuple[int, float],
        pending: Pending,
    ) -> None:
        self.bodies, self.block, self.pending = bodies, block, pending
        self.client, self.state = client, int(p.saveState(physicsClientId=client))
        self.arrays: dict[int, dict[str, Array]] = {
            uid: {name: value.copy() for name, value in vars(system).items() if isinstance(value, np.ndarray)}
            for uid, system in systems.items()
        }
        self.timesteps = {uid: system.dt for uid, system in systems.items()}
        self._finalizer = weakref.finalize(self, _forget, client, self.state)

    def write_back(self, systems: Mapping[int, ImplicitPd]) -> None:
        """Restore Bullet and the controllers to the saved state."""
        p.restoreState(stateId=self.state, physicsClientId=self.client)
        for uid, arrays in self.arrays.items():
            systems[uid].dt = self.timesteps[uid]
            for name, value in arrays.items():
                getattr(systems[uid], name)[:] = value

    def world_closed(self) -> None:
        """Forget the state, which was freed with its client; another world may reuse the numbers of both."""
        self._finalizer.detach()


def _forget(client: int, state: int) -> None:
    # At the end of the process the client may already be gone.
    with suppress(p.error):
        p.removeState(state, physicsClientId=client)
