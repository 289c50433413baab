from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dgrasp.objects.free import free_object
from dgrasp.scene.scene import TABLE_SIZE, TABLE_TOP, TABLE_XY
from dgrasp.scene.standing import standing
from raisim_like.rotations import matrix_from_euler, transform
from tests.scenes import free_hand, make_label

NAME = "004_sugar_box"


def test_a_label_that_knows_the_table_is_left_alone() -> None:
    label = make_label(free_hand())
    assert standing([label], {}) == [label]


@pytest.mark.parametrize(("angles", "height"), [((0.0, 0.0, 0.4), 0.175), ((np.pi / 2, 0.0, 0.0), 0.089)])
def test_an_object_in_space_comes_to_stand_with_its_hand(angles: tuple[float, ...], height: float) -> None:
    known = make_label(free_hand())
    T = transform(matrix_from_euler(np.array(angles)), np.array([3.0, -2.0, 0.0]))
    label = dataclasses.replace(known, T_WO=T, on_table=False)
    (put,) = standing([label], {NAME: free_object(NAME, "official", True)})
    # The box stands on a face, its centre half its height above the top.
    assert put.T_WO[2, 3] == pytest.approx(TABLE_TOP + height / 2, abs=1e-9)
    assert (put.T_WO[:3, :3] == T[:3, :3]).all() and not put.on_table
    reach = np.array(TABLE_SIZE[:2]) / 2 - 0.15
    assert (np.abs(put.T_WO[:2, 3] - TABLE_XY) < reach).all(), "it stands well on the table"
    shift = put.T_WO[:3, 3] - T[:3, 3]
    assert np.allclose(put.T_WH, label.T_WH + np.pad(shift[:, None], ((0, 1), (3, 0))), atol=1e-12)
    assert np.allclose(put.joints_W, label.joints_W + shift, atol=1e-12)
    assert put.start is not None and label.start is not None
    assert put.start.T_WO[:3, 3] - label.start.T_WO[:3, 3] == pytest.approx(shift)
    assert (put.hand_pose == label.hand_pose).all() and put.name == label.name
