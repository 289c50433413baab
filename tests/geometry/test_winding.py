from __future__ import annotations

import numpy as np
import pytest

from dgrasp.geometry.winding import leaking_columns, winding_grid
from tests.geometry.solids import ball, box, tube

LOW, COUNTS = np.array([-0.0195, -0.0195, -0.0195]), (40, 40, 40)


def test_points_of_a_box_are_counted_exactly() -> None:
    # Planes at +-10, +-5 and +-8 mm, points 1 mm apart at half millimetres: 20 x 10 x 16 of them are inside.
    vertices, faces = box((0.02, 0.01, 0.016))
    winding = winding_grid(vertices, faces, LOW, 0.001, COUNTS)
    assert set(np.unique(winding)) == {0, 1}
    assert winding.sum() == 20 * 10 * 16
    assert winding[20, 20, 20] == 1 and winding[0, 20, 20] == 0 and winding[39, 20, 20] == 0


def test_winding_adds_where_solids_overlap_and_turns_its_sign_with_the_faces() -> None:
    vertices, faces = box((0.02, 0.02, 0.02))
    twice = winding_grid(np.concatenate([vertices, vertices]), np.concatenate([faces, faces + 8]), LOW, 0.001, COUNTS)
    assert twice.max() == 2 and (twice > 0).sum() == 20**3
    assert winding_grid(vertices, faces[:, ::-1], LOW, 0.001, COUNTS).min() == -1


def test_what_lies_before_the_grid_counts_too() -> None:
    # The grid begins inside the ball, so the ray's entry lies before its first point.
    vertices, faces = ball(0.01)
    winding = winding_grid(vertices, faces, np.array([0.0005, -0.0005, -0.0005]), 0.001, (12, 2, 2))
    # Points at 0.5, 1.5, ... 11.5 mm of a ball of 10 mm, a little off its axis.
    assert winding[:, 0, 0].tolist() == [1] * 10 + [0, 0]


def test_points_on_edges_and_corners_belong_to_one_side() -> None:
    # The grid falls onto the faces, edges and corners of the box; still every ray leaves as often as it enters.
    vertices, faces = box((0.02, 0.02, 0.02))
    low = np.array([-0.012, -0.012, -0.012])
    assert leaking_columns(vertices, faces, low, 0.002, (13, 13, 13)) == 0
    assert (winding_grid(vertices, faces, low, 0.002, (13, 13, 13)) > 0).sum() in range(9**3, 11**3 + 1)


@pytest.mark.parametrize("turn", [0.3, 1.1])
def test_an_open_surface_leaks_and_a_closed_one_does_not(turn: float) -> None:
    R = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    vertices, faces = tube(0.01, 0.03)
    assert leaking_columns(vertices @ R, faces, LOW, 0.001, COUNTS) > 0
    vertices, faces = ball(0.01)
    assert leaking_columns(vertices @ R, faces, LOW, 0.001, COUNTS) == 0


def test_the_volume_of_a_ball() -> None:
    vertices, faces = ball(0.015)
    inside = winding_grid(vertices, faces, np.full(3, -0.01553), 0.0005, (64, 64, 64)) > 0
    assert inside.sum() * 0.0005**3 == pytest.approx(4 / 3 * np.pi * 0.015**3, rel=5e-3)
