from __future__ import annotations

import numpy as np
import pytest

from dgrasp.geometry.raster import Camera, Floor, Shaded, draw, shaded
from dgrasp.geometry.shape_mesh import shape_mesh
from raisim_like.shapes import Shape

RED, BLUE = (0.8, 0.1, 0.1), (0.1, 0.1, 0.8)
SIZE = (160, 120)
FRONT = Camera(np.array([2.0, 0.0, 0.0]), np.zeros(3), SIZE)
ABOVE = Camera(np.array([1e-6, 0.0, 2.0]), np.zeros(3), SIZE)


def ball(radius: float, color: tuple[float, float, float], place: tuple[float, float, float] = (0, 0, 0)) -> Shaded:
    return shaded(*shape_mesh(Shape("sphere", (radius,))), color).placed(np.eye(3), np.array(place))


def red(picture: np.ndarray) -> np.ndarray:
    return picture[..., 0].astype(int) > picture[..., 2].astype(int) + 30


def test_a_ball_is_as_large_and_where_it_should_be() -> None:
    picture = draw([ball(0.2, RED, (0.0, 0.3, 0.1))], FRONT)
    assert picture.shape == (120, 160, 3) and picture.dtype == np.uint8
    y, x = np.nonzero(red(picture))
    # World y is to the right of a camera that looks along -x, and the picture's y is downwards.
    per_m = 60.0 / np.tan(np.deg2rad(20.0)) / 2.0
    assert x.mean() + 0.5 == pytest.approx(80.0 + 0.3 * per_m, abs=1.0)
    assert y.mean() + 0.5 == pytest.approx(60.0 - 0.1 * per_m, abs=1.0)
    # Off the axis a ball's picture is stretched by 1 / cos^3.
    stretch = np.cos(np.arctan2(np.hypot(0.3, 0.1), 2.0)) ** -3
    assert len(x) == pytest.approx(np.pi * (0.2 * per_m) ** 2 * stretch, rel=0.03)


def test_what_is_nearer_hides_what_is_behind_in_any_order() -> None:
    near, far = ball(0.2, RED, (0.5, 0.0, 0.0)), ball(0.2, BLUE, (-0.5, 0.0, 0.0))
    picture = draw([near, far], FRONT)
    assert red(picture)[60, 80] and np.array_equal(picture, draw([far, near], FRONT))


def test_what_cuts_through_is_hidden_sample_by_sample() -> None:
    ring = shaded(*shape_mesh(Shape("cylinder", (0.3, 0.02))), RED)
    picture = draw([ball(0.2, BLUE), ring], FRONT)
    assert red(picture)[60, 80] and not red(picture)[52, 80] and not red(picture)[68, 80]


def test_round_is_shaded_smoothly_and_a_box_keeps_its_edges() -> None:
    smooth = shaded(*shape_mesh(Shape("sphere", (1.0,))), RED)
    directions = smooth.vertices[smooth.faces]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    assert ((directions * smooth.normals).sum(axis=-1) > 0.98).all()
    box = shaded(*shape_mesh(Shape("box", (1.0, 1.0, 1.0))), RED)
    assert np.abs(box.normals).max(axis=-1) == pytest.approx(1.0)


def test_light_comes_from_above() -> None:
    picture = draw([ball(0.4, RED)], FRONT).astype(int)
    assert picture[45, 80, 0] > picture[80, 80, 0] + 20


def test_the_floor_ends_at_its_corners_and_takes_a_shadow() -> None:
    floor = Floor(np.array([[-0.4, -0.4], [0.4, 0.4]]), 0.0, np.array([0.5, 0.5, 0.5]))
    bare = draw([], ABOVE, floor)
    assert bare[60, 80].tolist() == [128, 128, 128] and (bare[5, 5] > 230).all()
    # A ball 0.1 m above the floor, out of the picture's middle: its shadow is as dark as SHADOW says.
    shaded = draw([ball(0.1, RED, (0.0, 0.0, 0.2))], ABOVE, floor)
    dark = (shaded == 92).all(axis=-1)
    assert dark.sum() > 100 and not (dark & red(shaded)).any()


def test_a_floor_above_the_camera_and_what_is_behind_it_are_not_drawn() -> None:
    high = Floor(np.array([[-9.0, -9.0], [9.0, 9.0]]), 3.0, np.array([0.5, 0.5, 0.5]))
    level = Camera(np.array([2.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]), SIZE)
    nothing = draw([], level)
    assert np.array_equal(draw([ball(0.2, RED, (4.0, 0.0, 1.0))], level, high), nothing)
