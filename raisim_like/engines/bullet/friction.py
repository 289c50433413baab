"""Friction for PyBullet, which multiplies one coefficient per body instead of taking a table of pairs."""

from __future__ import annotations

import numpy as np

from raisim_like.errors import EngineError
from raisim_like.material import MaterialTable


def factors(table: MaterialTable, materials: list[str], touching: set[frozenset[str]]) -> dict[str, float]:
    """One coefficient per material, such that the product over each touching pair is the pair's friction.

    Raises `EngineError` if no such coefficients exist for the table.
    """
    names = sorted(set(materials))
    rows, targets = [], []
    for pair in sorted(touching, key=sorted):
        members = sorted(pair)
        first, second = members[0], members[-1]
        value = table.friction(first, second)
        row = np.zeros(len(names))
        row[names.index(first)] += 1.0
        row[names.index(second)] += 1.0
        rows.append(row)
        targets.append(np.log(max(value, 1e-12)))
    if not rows:
        return {name: float(np.sqrt(table.default_friction)) for name in names}
    A, b = np.array(rows), np.array(targets)
    # The minimum-norm deviation from sqrt(default) leaves unconstrained materials at the default.
    start = np.full(len(names), 0.5 * np.log(max(table.default_friction, 1e-12)))
    x = start + np.linalg.lstsq(A, b - A @ start, rcond=None)[0]
    worst = int(np.argmax(np.abs(A @ x - b)))
    if abs(A[worst] @ x - b[worst]) > 1e-9:
        pair_names = " and ".join(repr(n) for n, used in zip(names, A[worst], strict=True) if used)
        raise EngineError(
            f"PyBullet multiplies one friction coefficient per body, which cannot give {pair_names} "
            f"the friction {np.exp(b[worst]):.3g} together with the other pairs; choose frictions "
            "that are products of one coefficient per material"
        )
    return {name: float(np.exp(value)) for name, value in zip(names, x, strict=True)}
