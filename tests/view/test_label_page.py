"""Pictures of labels, with the surfaces and with the collision shapes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgrasp.files.paths import data_root
from dgrasp.labels.formats.native import read_native
from dgrasp.objects.free import free_object
from dgrasp.objects.model import object_model
from dgrasp.scene.standing import standing
from dgrasp.types import Array
from dgrasp.view.label_page import SIZE, label_pictures
from raisim_like.shapes import Shape
from tests.export.sequences import box
from tests.scenes import free_hand, make_label


def blue(picture: Array) -> int:
    """The number of pixels that show the object, the only blue thing."""
    r, g, b = (picture[..., k].astype(int) for k in range(3))
    return int(((b > r + 25) & (b > g + 10)).sum())


def test_hand_and_object_are_whole_in_the_picture() -> None:
    # The tallest object, grasped at its rim, and standing.
    chosen = [label for label in read_native(data_root() / "free" / "labels" / "free_test.npz")
              if label.object_id == "019_pitcher_base" and label.index == 1]
    objects = {"019_pitcher_base": free_object("019_pitcher_base", "ycb", False)}
    picture = label_pictures(standing(chosen, objects), free_hand(), objects)[0].astype(int)
    # Neither grey nor the table's colour.
    colored = np.abs(picture[..., 0] - picture[..., 2]) > 25
    assert colored.mean() > 0.05
    assert not colored[[0, -1]].any() and not colored[:, [0, -1]].any()


def test_the_shapes_are_drawn_in_place_of_the_mesh(tmp_path: Path) -> None:
    hand = free_hand()
    mesh = box(0.02, 0.02, 0.02)
    file = tmp_path / "mesh.obj"
    file.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in mesh.vertices.tolist())
                    + "".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist()))
    # It looks like a cube of 4 cm and collides like one of 8 cm, which covers four times the area.
    cube = object_model("cube", (Shape("box", (0.08, 0.08, 0.08)),), 0.1, False)
    label = make_label(hand, "cube")
    T_WH = label.T_WH.copy()
    T_WH[:3, 3] += [0.0, 0.0, 0.5]  # Out of the picture.
    label = replace(label, T_WH=T_WH)
    objects = {"cube": replace(cube, mesh=file)}
    surface, shapes = (label_pictures([label], hand, objects, shapes)[0] for shapes in (False, True))
    assert surface.shape == (SIZE[1], SIZE[0], 3)
    assert blue(shapes) / blue(surface) == pytest.approx(4.0, rel=0.25)
