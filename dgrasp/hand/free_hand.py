"""The free hand as a RaiSim-style URDF: `python -m dgrasp.hand.free_hand [FILE]` writes it, always the same bytes.

The design stands in `dgrasp.hand.free_anatomy`, the layout of the file in `dgrasp.hand.urdf_writer`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from dgrasp.hand.free_anatomy import HandPart, hand_parts, tip_offsets
from dgrasp.hand.urdf_writer import LinkPart, hand_urdf
from dgrasp.objects.inertia import combine, shape_properties

HAND_NAME = "free"
"""The hand's id in labels (`GraspLabel.hand`)."""

URDF_PATH = Path(__file__).resolve().parents[2] / "data" / "free" / "hand" / "free_hand.urdf"
"""The generated file that ships."""

DENSITY = 1100.0
"""kg/m^3 of every part; overlaps of neighbouring shapes count twice."""


def _link(part: HandPart) -> LinkPart:
    whole = combine(shape_properties(shape) for shape in part.shapes)
    mass = DENSITY * whole.volume
    return LinkPart(part.offset, part.limits, part.shapes, mass, whole.center_of_mass, whole.inertia_of(mass))


def free_hand_urdf() -> str:
    """The text of the URDF."""
    command = "python -m dgrasp.hand.free_hand"
    comment = f"Written by `{command}`; change dgrasp/hand/free_anatomy.py, not this file."
    tips = np.array([offset for _, offset in tip_offsets().values()])
    return hand_urdf("free_hand", comment, [_link(part) for part in hand_parts()], tips, massless=True)


def main(arguments: list[str]) -> None:
    """Write the URDF to the file given, or to where it ships."""
    path = Path(arguments[0]) if arguments else URDF_PATH
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(free_hand_urdf(), encoding="utf-8", newline="\n")
    print(path)


if __name__ == "__main__":
    main(sys.argv[1:])
