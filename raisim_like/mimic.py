"""Joints that follow another one (URDF's `<mimic>`): q = multiplier * q_leader + offset."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Mimic:
    """What a joint follows: the index of a joint that follows none, the multiplier, and the offset in rad or m."""

    leader: int
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Ties:
    """The joints of a system that follow others: q = matrix @ q + offset holds for all of its coordinates q (dof,).

    followers: their indices. free: indices of the joints that follow none. matrix (dof, dof): the column of a follower
    is zero. offset (dof,): rad or m.
    """

    followers: Array
    free: Array
    matrix: Array
    offset: Array

    @classmethod
    def of(cls, mimics: Sequence[Mimic | None]) -> Ties:
        """The ties of a system whose joints have these mimics; None for a joint that follows none."""
        matrix, offset = np.eye(len(mimics)), np.zeros(len(mimics))
        for i, mimic in enumerate(mimics):
            if mimic is not None:
                matrix[i, i], matrix[i, mimic.leader], offset[i] = 0.0, mimic.multiplier, mimic.offset
        follows = np.array([mimic is not None for mimic in mimics], dtype=bool)
        return cls(np.flatnonzero(follows), np.flatnonzero(~follows), matrix, offset)

    def coordinates(self, q: Array) -> Array:
        """Coordinates (..., dof) with those of the followers replaced by what they must be."""
        return q @ self.matrix.T + self.offset if len(self.followers) else q

    def velocities(self, v: Array) -> Array:
        """The same for velocities (..., dof)."""
        return v @ self.matrix.T if len(self.followers) else v


def resolve_mimics(
    moving: list[dict[str, Any]], joints: Sequence[Element], fail: Callable[[str, str], Exception],
    numbers: Callable[[str | None, int, str], Array],
) -> None:
    """Set the entry `mimic` of all moving links, and let the limits of leaders and followers agree.

    A joint that follows a follower gets the leader of both. A leader's limits become those at which all of its
    followers are within theirs too. moving: links with joint, lower, upper. joints: the file's. Raises what `fail`
    makes of a place and a message.
    """
    index = {entry["joint"]: i for i, entry in enumerate(moving)}
    names = {joint.get("name") for joint in joints}
    said: dict[int, Mimic] = {}
    for joint in joints:
        node, name = joint.find("mimic"), str(joint.get("name"))
        if node is None or name not in index:  # A fixed joint does not move, whatever it mimics.
            continue
        where, leader = f"joint {name!r} mimic", node.get("joint")
        if leader not in index:
            why = "is fixed" if leader in names else "is not in the file"
            raise fail(where, f"joint {leader!r} {why}; expected the name of a joint that moves")
        multiplier, offset = (
            float(numbers(node.get(key, default), 1, f"{where} {key}")[0])
            for key, default in (("multiplier", "1"), ("offset", "0"))
        )
        if multiplier == 0.0:
            raise fail(where, "multiplier 0 would keep the joint still; make it a fixed joint instead")
        said[index[name]] = Mimic(index[leader], multiplier, offset)
    for i, entry in enumerate(moving):
        entry["mimic"] = _composed(i, said, moving, fail) if i in said else None
    for entry in moving:
        if entry["mimic"] is not None:
            _narrow(moving[entry["mimic"].leader], entry, fail)
    for entry in moving:
        if entry["mimic"] is not None:
            leader, mimic = moving[entry["mimic"].leader], entry["mimic"]
            ends = [mimic.multiplier * leader[end] + mimic.offset for end in ("lower", "upper")]
            entry["lower"], entry["upper"] = min(ends), max(ends)


def _composed(
    i: int, said: dict[int, Mimic], moving: list[dict[str, Any]], fail: Callable[[str, str], Exception]
) -> Mimic:
    """What joint i follows in the end: the first joint on its path of mimics that follows none."""
    mimic, path = said[i], [moving[i]["joint"]]
    while mimic.leader in said:
        path.append(moving[mimic.leader]["joint"])
        if path[-1] in path[:-1]:
            circle = " -> ".join(path)
            raise fail(f"joint {path[0]!r} mimic", f"it follows itself ({circle}); remove one <mimic> of these")
        next_one = said[mimic.leader]
        mimic = Mimic(next_one.leader, mimic.multiplier * next_one.multiplier,
                      mimic.multiplier * next_one.offset + mimic.offset)  # fmt: skip
    return mimic


def _narrow(leader: dict[str, Any], follower: dict[str, Any], fail: Callable[[str, str], Exception]) -> None:
    """Cut the leader's limits to those that keep the follower within its own."""
    mimic = follower["mimic"]
    ends = [(follower[end] - mimic.offset) / mimic.multiplier for end in ("lower", "upper")]
    lower, upper = max(leader["lower"], min(ends)), min(leader["upper"], max(ends))
    if lower > upper:
        if not math.isclose(lower, upper, abs_tol=1e-9):
            raise fail(
                f"joint {follower['joint']!r} mimic",
                f"its limits {follower['lower']:g} to {follower['upper']:g} need joint {leader['joint']!r} between "
                f"{min(ends):g} and {max(ends):g}, whose limits are {leader['lower']:g} to {leader['upper']:g}; "
                "change the limits, the multiplier or the offset",
            )
        upper = lower
    leader["lower"], leader["upper"] = lower, upper
