"""Contact points as the engines report them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Contact:
    """One contact point between two bodies.

    body_a, body_b: body ids; link_a, link_b: moving-link indices, -1 for the base or a rigid body.
    point_W: (3,) m, a point on B. normal_W: (3,) unit, from B towards A. depth: m, positive when penetrating.
    impulse: N s, along the normal in the last substep. tangential_impulse_W: (3,) N s, of friction on A.
    """

    body_a: int
    body_b: int
    link_a: int
    link_b: int
    point_W: NDArray[np.float64]
    normal_W: NDArray[np.float64]
    depth: float
    impulse: float
    tangential_impulse_W: NDArray[np.float64]

    @property
    def impulse_W(self) -> NDArray[np.float64]:
        """(3,) N s: the total impulse on A, world; B receives its negative."""
        return self.impulse * self.normal_W + self.tangential_impulse_W
