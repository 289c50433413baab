"""The free hand as a RaiSim-style URDF: `python -m dgrasp.hand.free.hand [FILE]` writes it.

The hand is cut from the skin that ships (`dgrasp.hand.free.skin`), in the same way as a MANO hand: a capsule per finger
part, a box for the palm. Its joint limits are those of `dgrasp.hand.free.anatomy`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from dgrasp.files.atomic import write_atomic
from dgrasp.files.paths import data_root
from dgrasp.hand.builder.build import primitive_links
from dgrasp.hand.builder.urdf_writer import hand_urdf
from dgrasp.hand.free.skin import free_limits, free_skin
from dgrasp.hand.mano.skeleton import DISTAL_PARTS

URDF_PATH = data_root() / "free" / "hand" / "free_hand.urdf"
"""The generated file that ships."""


def free_hand_urdf() -> str:
    """The text of the URDF."""
    # The comment of the file that ships, with the module names of its time: policies and results name the file's hash.
    command = "python -m dgrasp.hand.free_hand"
    comment = f"Written by `{command}` from free_skin.npz; change dgrasp/hand/free_anatomy.py, not this file."
    model = free_skin()
    vertices, joints = model.shaped(np.zeros(0))
    tips = vertices[model.tip_vertices] - joints[DISTAL_PARTS]
    return hand_urdf("free_hand", comment, primitive_links(model, free_limits()), tips, massless=True)


def main(arguments: list[str]) -> None:
    """Write the URDF to the given file, by default to `URDF_PATH`."""
    path = Path(arguments[0]) if arguments else URDF_PATH
    write_atomic(path, free_hand_urdf())
    print(path)


if __name__ == "__main__":
    main(sys.argv[1:])
