"""Friction per pair of materials, as in RaiSim. Contacts do not bounce."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from raisim_like.errors import EngineError


@dataclass
class MaterialTable:
    """Friction by pair of material names; pairs that are not in the table have the default."""

    default_friction: float = 0.8
    pairs: dict[frozenset[str], float] = field(default_factory=dict)

    def set_pair(self, first: str, second: str, friction: float) -> None:
        """Set the friction coefficient between two materials, or of a material with itself."""
        if not (np.isfinite(friction) and friction >= 0):
            raise EngineError(f"friction of {first!r} and {second!r} must be a number >= 0, got {friction!r}")
        self.pairs[frozenset((first, second))] = float(friction)

    def friction(self, first: str, second: str) -> float:
        """Friction coefficient between two materials."""
        return self.pairs.get(frozenset((first, second)), self.default_friction)
