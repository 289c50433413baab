"""External forces that act in the next substep only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from raisim_like.engines.protocol import Array


@dataclass
class Pending:
    """Sums of the requested forces, by body id.

    wrenches: (2, 3) force at the centre of mass and torque of rigid bodies, world. generalized: (dof,) of systems.
    """

    wrenches: dict[int, Array] = field(default_factory=dict)
    generalized: dict[int, Array] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.wrenches or self.generalized)

    def add_wrench(self, body: int, force: Array, torque: Array) -> None:
        """Add a force (3,) N at the centre of mass, and a torque (3,) N m, on a rigid body, world frame."""
        self.wrenches[body] = self.wrenches.get(body, np.zeros((2, 3))) + np.array([force, torque])

    def add_generalized(self, body: int, force: Array) -> None:
        """Add a generalised force (dof,) on a system."""
        self.generalized[body] = self.generalized.get(body, 0.0) + np.asarray(force, dtype=float)

    def forget(self, body: int) -> None:
        """Drop the forces on a body that was removed."""
        self.wrenches.pop(body, None)
        self.generalized.pop(body, None)

    def copy(self) -> Pending:
        """An independent copy."""
        return Pending(dict(self.wrenches), dict(self.generalized))
