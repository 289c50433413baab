"""Masses that URDFs leave out, with a warning."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from raisim_like.shape_inertia import DENSITY, shape_inertia


def fill_gaps(path: Path, moving: list[dict[str, Any]]) -> None:
    """Inertials from the shapes of the moving links that state no mass; a warning names these.

    A link that hangs on links without shapes of which one has a mass is left as it is: these carry it, as the wrist's
    sliders do in RaiSim's files. Links without shapes stay massless.
    """
    filled, unknown = [], []
    for entry in moving:
        if _has_mass(entry) or not entry["shapes"] or _carried(entry, moving):
            continue
        try:
            inertials = [shape_inertia(shape) for shape in entry["shapes"]]
        except ValueError as error:
            unknown.append(f"{entry['name']} ({error})")
            continue
        if any(mass > 0.0 for mass, _, _ in inertials):
            entry["inertials"] = inertials
            filled.append(entry["name"])
    state = "state <inertial> in these links to choose their masses"
    if filled:
        _warn(f"{path}: no <inertial> with a mass in {', '.join(filled)}; taken from the collision shapes at "
              f"{DENSITY:g} kg/m3; {state}")
    if unknown:
        _warn(f"{path}: no <inertial> in {', '.join(unknown)}; they are simulated with next to no mass; {state}")


def _has_mass(entry: dict[str, Any]) -> bool:
    return any(mass > 0.0 for mass, _, _ in entry["inertials"])


def _carried(entry: dict[str, Any], moving: list[dict[str, Any]]) -> bool:
    above = entry["parent"]
    while above >= 0 and not moving[above]["shapes"]:
        if _has_mass(moving[above]):
            return True
        above = moving[above]["parent"]
    return False


def _warn(message: str) -> None:
    warnings.warn(message, stacklevel=4)  # Where `read_urdf` was called.
