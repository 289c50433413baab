"""What URDFs leave out or ask for in vain, each with a warning: missing masses, joints that should follow others."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from raisim_like.shape_inertia import DENSITY, shape_inertia


def fill_gaps(path: Path, root: Element, moving: list[dict[str, Any]]) -> None:
    """Inertials from the shapes of the moving links that state no mass; a warning names these, and joints that mimic.

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
    mimics = [f"{joint.get('name')} (of {mimic.get('joint')})" for joint in root.findall("joint")
              if joint.get("type") != "fixed" and (mimic := joint.find("mimic")) is not None]
    if mimics:
        _warn(f"{path}: <mimic> is not simulated: {', '.join(mimics)} move on their own; remove <mimic> where that is "
              "meant, or make these joints fixed")


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
