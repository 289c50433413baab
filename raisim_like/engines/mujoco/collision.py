"""Which bodies may collide, in MuJoCo's terms."""

from __future__ import annotations

from collections.abc import Mapping

from raisim_like.errors import EngineError
from raisim_like.urdf import UrdfModel


def collision_bits(masks: Mapping[int, int], within: Mapping[int, bool]) -> dict[int, tuple[int, int]]:
    """(contype, conaffinity) by body id, such that two bodies collide only if both of their masks allow it.

    In MuJoCo one side is enough. Therefore each mask becomes a class with one bit, and a body's affinity is the set of
    classes that it may collide with. within: id of each articulated system -> whether its links collide with each
    other; each system is a class of its own. Raises `EngineError` if there are more classes than bits.
    """
    class_of = {body: (mask, body if body in within else -1) for body, mask in masks.items()}
    classes = list(dict.fromkeys(class_of.values()))
    if len(classes) > 31:
        raise EngineError(
            f"MuJoCo can distinguish 31 kinds of collision masks, but this world has {len(classes)}; use fewer "
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
    """All pairs (link, link above it in its chain) in which both have shapes; they never collide."""
    found = set()
    for i, link in enumerate(urdf.links):
        above = link.parent
        while above >= 0:
            if link.shapes and urdf.links[above].shapes:
                found.add((i, above))
            above = urdf.links[above].parent
    return found
