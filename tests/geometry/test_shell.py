from __future__ import annotations

import numpy as np
import pytest

from dgrasp.geometry.intersection import body
from dgrasp.geometry.shell import cubes_inside, surface_cubes
from tests.geometry.solids import ball, box, moved


def test_cubes_of_a_plate_by_hand() -> None:
    # A plate of 41 x 31 x 1 mm around the origin lies in cubes -4..4 by -3..3 of the layer at 0.
    cubes = surface_cubes(body([box((0.041, 0.031, 0.001))]))
    assert {tuple(c) for c in cubes.tolist()} == {(x, y, 0) for x in range(-4, 5) for y in range(-3, 4)}


def test_a_solid_counts_by_its_surface_alone() -> None:
    # A 51 mm block in cubes of 5 mm: 11^3 cubes, of which 9^3 do not meet its surface.
    cubes = surface_cubes(body([box((0.051, 0.051, 0.051))]))
    assert len(cubes) == 11**3 - 9**3
    everything = cubes_inside(cubes, body([box((0.2, 0.2, 0.2))]))
    assert everything == pytest.approx((11**3 - 9**3) * 0.005**3)
    # A finger that is wholly inside the block counts as nothing.
    assert cubes_inside(cubes, body([ball(0.012)])) == 0.0


def test_a_finger_on_a_face() -> None:
    # A box of 18 x 18 mm dips into the top layer of cubes (centres at z = 25 mm): 3 x 3 centres are inside.
    cubes = surface_cubes(body([box((0.051, 0.051, 0.051))]))
    finger = body([box((0.012, 0.012, 0.02))]).placed(moved(z=0.0301))
    assert cubes_inside(cubes, finger) == pytest.approx(9 * 0.005**3)
    assert cubes_inside(cubes, finger.placed(moved(z=0.02))) == 0.0
    assert cubes_inside(np.zeros((0, 3), int), finger) == 0.0
