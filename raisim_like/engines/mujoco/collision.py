"""Who may collide with whom, in MuJoCo's terms."""

from __future__ import annotations

from collections.abc import Mapping

from raisim_like.errors import EngineError
from raisim_like.urdf import UrdfModel


def collision_bits(masks: Mapping[int, int], within: Mapping[int, bool]) -> dict[int, tuple[int, int]]:
    """contype and conaffinity by body id, so that two bodies collide when both of their masks say so.

    MuJoCo lets one side decide. So each mask becomes a class with one bit, and a body's affinity is the classes that
    it agrees with. within: the articulated systems, and whether their links collide with each other; each is a class
    of its own. Raises `EngineError` when there are more classes than bits.
    """
    class_of = {body: (mask, body if body in within else -1) for body, mask in masks.items()}
    classes = list(dict.fromkeys(class_of.values()))
    if len(classes) > 31:
        raise EngineError(
            f"MuJoCo tells 31 kinds of collision masks apart, a world with {len(classes)} was asked for; use fewer "
            "different masks, or fewer articulated systems"
        )
    bits = {}
    for body, mine in masks.items():
        affinity = 0
        for k, (mask, system) in enumerate(classes):
            agree = mask & 0xFF & mine >> 8 and mine & 0xFF & mask >> 8
            if agree and (system != body or within[body]):
                affinity |= 1 << k
        bits[body] = (1 << classes.index(class_of[body]), affinity)
    return bits


def chains(urdf: UrdfModel) -> set[tuple[int, int]]:
    """All (link, link that it hangs on, directly or not) of which both have shapes: they never collide."""
    found = set()
    for i, link in enumerate(urdf.links):
        above = link.parent
        while above >= 0:
            if link.shapes and urdf.links[above].shapes:
                found.add((i, above))
            above = urdf.links[above].parent
    return found
