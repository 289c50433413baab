"""Friction and restitution per pair of materials, as in RaiSim."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from raisim_like.errors import EngineError


@dataclass
class MaterialTable:
    """Pairs of material names with their friction; a pair that is not named has the default.

    PyBullet multiplies one coefficient per body. `factors` finds coefficients whose products are the
    wanted pairs, and refuses a table that no such coefficients can express.
    """

    default_friction: float = 0.8
    pairs: dict[frozenset[str], float] = field(default_factory=dict)

    def set_pair(self, first: str, second: str, friction: float) -> None:
        """Friction coefficient between two materials (also a material with itself)."""
        if not (np.isfinite(friction) and friction >= 0):
            raise EngineError(f"friction of {first!r} and {second!r} must be a number >= 0, got {friction!r}")
        self.pairs[frozenset((first, second))] = float(friction)

    def friction(self, first: str, second: str) -> float:
        """Friction coefficient between two materials."""
        return self.pairs.get(frozenset((first, second)), self.default_friction)

    def factors(self, materials: list[str], touching: set[frozenset[str]]) -> dict[str, float]:
        """One coefficient per material so that the product over each touching pair is its friction."""
        names = sorted(set(materials))
        rows, targets = [], []
        for pair in sorted(touching, key=sorted):
            members = sorted(pair)
            first, second = members[0], members[-1]
            value = self.friction(first, second)
            row = np.zeros(len(names))
            row[names.index(first)] += 1.0
            row[names.index(second)] += 1.0
            rows.append(row)
            targets.append(np.log(max(value, 1e-12)))
        if not rows:
            return {name: float(np.sqrt(self.default_friction)) for name in names}
        A, b = np.array(rows), np.array(targets)
        # The minimum-norm deviation from sqrt(default) leaves unconstrained materials at the default.
        start = np.full(len(names), 0.5 * np.log(max(self.default_friction, 1e-12)))
        x = start + np.linalg.lstsq(A, b - A @ start, rcond=None)[0]
        worst = int(np.argmax(np.abs(A @ x - b)))
        if abs(A[worst] @ x - b[worst]) > 1e-9:
            pair_names = " and ".join(repr(n) for n, used in zip(names, A[worst], strict=True) if used)
            raise EngineError(
                f"PyBullet multiplies one friction coefficient per body, which cannot give {pair_names} "
                f"the friction {np.exp(b[worst]):.3g} beside the other pairs; choose pairs that factor"
            )
        return {name: float(np.exp(value)) for name, value in zip(names, x, strict=True)}
