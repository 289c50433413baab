from __future__ import annotations

import numpy as np
import pytest

from dgrasp.geometry.intersection import Body, Overlap, body, join, near, overlap
from raisim_like.rotations import matrix_from_euler, transform
from tests.geometry.solids import ball, box, lens, moved, tube


@pytest.mark.parametrize("distance", [0.0, 0.02, 0.04, 0.055])
def test_two_balls_share_a_lens(distance: float) -> None:
    one = body([ball(0.03)])
    shared = overlap(one, one.placed(moved(x=distance)))
    assert shared.exact and not shared.disagrees
    assert shared.volume == pytest.approx(lens(0.03, distance), rel=2e-3, abs=1e-8)
    assert shared.by_points == pytest.approx(lens(0.03, distance), rel=0.04, abs=5e-8)


def test_boxes_by_hand() -> None:
    # 4 cm cubes: half-way diagonally they share 2 cm cubes; one within the other is shared whole; apart, nothing.
    cube = body([box((0.04, 0.04, 0.04))])
    assert overlap(cube, cube.placed(moved(0.02, 0.02, 0.02))).volume == pytest.approx(8e-6)
    assert overlap(cube, body([box((0.01, 0.02, 0.03), (0.005, 0.0, 0.0))])).volume == pytest.approx(6e-6)
    assert overlap(cube, cube.placed(moved(0.05))) == Overlap(0.0, 0.0, True)
    assert overlap(cube, cube.placed(moved(0.04))).volume == pytest.approx(0.0, abs=1e-12)


def test_the_order_and_the_frame_do_not_matter() -> None:
    one, two = body([ball(0.03)]), body([box((0.04, 0.02, 0.06), (0.02, 0.01, 0.0))])
    T = transform(matrix_from_euler(np.array([0.4, -0.8, 1.9])), np.array([0.3, -0.2, 0.7]))
    first = overlap(one, two).volume
    assert overlap(two, one).volume == pytest.approx(first, rel=1e-9)
    assert overlap(one.placed(T), two.placed(T)).volume == pytest.approx(first, rel=1e-6)


def test_parts_that_overlap_count_once() -> None:
    # Two bars that cross inside a slab: 2 * 6 * 2 * 1 - 2 * 2 * 1 cm^3 in its middle centimetre.
    bars = body([box((0.06, 0.02, 0.03)), box((0.02, 0.06, 0.03))])
    slab = body([box((0.1, 0.1, 0.01))])
    shared = overlap(bars, slab)
    assert shared.volume == pytest.approx(20e-6) and shared.by_points == pytest.approx(20e-6, rel=0.03)
    assert join([body([m]) for m in (box((0.06, 0.02, 0.03)), box((0.02, 0.06, 0.03)))]).solid.volume() == \
        pytest.approx(bars.solid.volume())


def test_an_open_finger_is_capped() -> None:
    # A tube of radius 1 cm and length 4 cm, open at both ends like a finger cut from a skin, dips 1 cm into a block.
    finger = body([tube(0.01, 0.04)])
    block = body([box((0.1, 0.1, 0.1), (0.0, 0.0, 0.06))])
    assert finger.holes == 2
    shared = overlap(finger, block)
    assert shared.exact and shared.volume == pytest.approx(24 * 1e-4 * np.sin(2 * np.pi / 48) * 0.01, rel=1e-9)


def test_a_mesh_that_is_no_solid_is_counted_by_points_and_says_so() -> None:
    cube = body([box((0.04, 0.04, 0.04))])
    broken = Body(cube.vertices, cube.faces, None, 0)
    shared = overlap(broken.placed(moved(0.02)), cube)
    assert not shared.exact and shared.volume == shared.by_points == pytest.approx(32e-6, rel=0.02)
    assert join([broken, cube]).solid is None and broken.surface()[0] is broken.vertices


def test_disagreement_is_told() -> None:
    assert Overlap(2.0e-6, 2.2e-6, True).disagrees
    assert not Overlap(2.0e-6, 2.09e-6, True).disagrees
    # Below 0.1 cm^3 a few points decide.
    assert not Overlap(0.10e-6, 0.19e-6, True).disagrees
    # A surface that cuts through itself: booleans count the doubly wound part twice, points do not.
    vertices, faces = box((0.04, 0.04, 0.04))
    other, _ = box((0.04, 0.04, 0.04), (0.02, 0.0, 0.0))
    twice = body([(np.concatenate([vertices, other]), np.concatenate([faces, faces + 8]))])
    shared = overlap(twice, body([box((0.2, 0.2, 0.2))]))
    assert shared.by_points == pytest.approx(96e-6, rel=0.02)
    assert shared.disagrees == (abs(shared.volume - 96e-6) > 5e-6)


def test_near_leaves_out_what_cannot_touch() -> None:
    balls = [body([ball(0.01)]).placed(moved(x)) for x in (0.0, 0.05, 0.2)]
    assert near(balls, body([box((0.12, 0.01, 0.01))])) == balls[:2]


def test_surface_of_a_union_has_no_inside() -> None:
    crossing = body([box((0.06, 0.02, 0.02)), box((0.02, 0.06, 0.02))])
    vertices, faces = crossing.surface()
    assert not ((np.abs(vertices) < 0.0099).all(axis=1)).any()
    assert body([(vertices, faces)]).solid.volume() == pytest.approx(2 * 24e-6 - 8e-6)
