"""Figures of one hand, or of two side by side (A and B): volumes, masses, joint offsets, limits."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from dgrasp.geometry.inside import union_volume
from dgrasp.hand.mano.skeleton import FINGERS, N_PARTS, PARTS
from dgrasp.hand.model import HandModel
from dgrasp.hand.store import NamedHand
from dgrasp.types import Array

Rows = dict[str, dict[str, Any]]


def part_figures(hand: NamedHand) -> Rows:
    """Per part: volume_cm3 of the union of its collision shapes, mass_g, offset_mm (3,) from its parent part, and for
    built hands mesh_cm3 and overlap of mesh and shapes."""
    model = hand.model
    rows: Rows = {}
    for index, name in enumerate(PARTS):
        last = int(model.part_links[index])
        # The palm's mass may hang on any of the wrist's six links, a finger part's on any of its three.
        own = range(0 if index == 0 else last - 2, last + 1)
        shapes = [shape for link in own for shape in model.urdf.links[link].shapes]
        rows[name] = {
            "volume_cm3": union_volume(shapes) * 1e6 if shapes else 0.0,
            "mass_g": 1e3 * sum(model.urdf.links[link].mass for link in own),
            "offset_mm": 1e3 * model.offsets[index],
        }
        built = hand.meta.get("parts", {}).get(name)
        if built:
            rows[name] |= {"mesh_cm3": built["mesh_volume_cm3"], "overlap": built["overlap"]}
    return rows


def limit_degrees(model: HandModel) -> Array:
    """(15, 3, 2) limits of the finger parts' rotations about x, y, z, degrees."""
    return np.degrees(model.limits[6:]).reshape(N_PARTS - 1, 3, 2)


def places_mm(model: HandModel) -> dict[str, Array]:
    """(3,) mm per finger joint and fingertip, in the parent part's frame, each finger from the palm outwards."""
    places = {}
    for index, name in enumerate(PARTS[1:], start=1):
        places[name] = 1e3 * model.offsets[index]
        if name.endswith("distal"):
            finger = (index - 1) // 3
            places[f"{FINGERS[finger]}_tip"] = 1e3 * model.tips[finger]
    return places


def print_report(hands: list[NamedHand]) -> None:
    """One hand's figures as tables, or two hands' with their differences."""
    console = Console(highlight=False)
    names = ["A ", "B "][: len(hands)] if len(hands) > 1 else [""]
    for name, hand in zip(names, hands, strict=True):
        line = f"{name}{hand.model.id}: {1e3 * hand.model.urdf.mass:.0f} g"
        if hand.meta:
            line += f", {hand.meta['side']}, from {hand.meta['model_file']}, limits: {hand.meta['limits']}"
        console.print(line, soft_wrap=True)
    for table in (_parts_table(hands, names), _places_table(hands, names), _limits_table(hands, names)):
        console.print(table)


def _table(title: str, first: str, columns: list[str]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column(first)
    for column in columns:
        table.add_column(column, justify="right")
    return table


def _parts_table(hands: list[NamedHand], names: list[str]) -> Table:
    """Volumes of the collision shapes, and masses; for built hands also volumes of the meshes, and the overlap of both.
    """
    keys = [["volume_cm3", "mass_g", *(["mesh_cm3", "overlap"] if hand.meta else [])] for hand in hands]
    heads = {"volume_cm3": "shapes cm3", "mass_g": "g", "mesh_cm3": "mesh cm3", "overlap": "overlap"}
    columns = [name + heads[key] for name, own in zip(names, keys, strict=True) for key in own]
    table = _table("parts", "part", columns + ["B/A cm3"] * (len(hands) - 1))
    figures = [part_figures(hand) for hand in hands]
    total = {key: [sum(row.get(key, 0.0) for row in rows.values()) for rows in figures]
             for key in ("volume_cm3", "mass_g", "mesh_cm3")}  # fmt: skip

    def ratio(volumes: list[float]) -> list[str]:
        return [f"{volumes[1] / volumes[0]:.2f}" if volumes[0] > 0 else "-"] if len(volumes) == 2 else []

    for part in PARTS:
        cells = [f"{figures[k][part].get(key, np.nan):.2f}" for k, own in enumerate(keys) for key in own]
        table.add_row(part, *cells, *ratio([rows[part]["volume_cm3"] for rows in figures]))
    table.add_section()
    cells = [f"{total[key][k]:.1f}" if key in total else "" for k, own in enumerate(keys) for key in own]
    table.add_row("sum", *cells, *ratio(total["volume_cm3"]))
    return table


def _places_table(hands: list[NamedHand], names: list[str]) -> Table:
    columns = [f"{name}x y z" for name in names] + ["distance"] * (len(hands) - 1)
    table = _table("joints, mm in the parent part's frame", "joint", columns)
    places = [places_mm(hand.model) for hand in hands]
    for joint in places[0]:
        cells = [" ".join(f"{v:6.1f}" for v in place[joint]) for place in places]
        if len(hands) == 2:
            cells.append(f"{np.linalg.norm(places[1][joint] - places[0][joint]):.1f}")
        table.add_row(joint, *cells)
    return table


def _limits_table(hands: list[NamedHand], names: list[str]) -> Table:
    table = _table("limits, degrees", "part", [f"{name}{axis}" for name in names for axis in "xyz"])
    limits = [limit_degrees(hand.model) for hand in hands]
    for index, part in enumerate(PARTS[1:]):
        table.add_row(part, *(f"{low:.0f} {high:.0f}" for each in limits for low, high in each[index]))
    return table
