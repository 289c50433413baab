"""The distances between a solid and its shapes, against those worked out by hand."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest

from dgrasp.geometry.surface_distance import SampledSurface, surface_samples
from dgrasp.objects.add.judge import judge
from dgrasp.objects.add.repair import RepairedSolid
from raisim_like.shapes import Shape

CUBE = RepairedSolid(manifold3d.Manifold.cube((0.04, 0.04, 0.04), True), ())


def test_the_same_surface_has_no_gaps() -> None:
    gaps = judge(CUBE, (Shape("box", (0.04, 0.04, 0.04)),))
    assert gaps.largest < 1e-9 and gaps.share_close == 1.0 and gaps.remarks() == []


def test_a_shape_that_is_too_long_stands_off() -> None:
    # 5 mm too long towards +x. Of the box's surface, the end and the last 3 mm of four sides are over 2 mm away:
    # (40 * 40 + 4 * 40 * 3) of 2 * 40 * 40 + 4 * 40 * 45 mm2 = 20%. Of the cube's, it is the end, 1 / 6, less its rim,
    # because the corners of the end are on the box's sides: (36 / 40)^2 / 6 = 13.5%.
    gaps = judge(CUBE, (Shape("box", (0.045, 0.04, 0.04), (0.0025, 0.0, 0.0)),))
    assert gaps.largest == pytest.approx(0.005, abs=2e-4)
    assert (gaps.added_by > 0.002).mean() == pytest.approx(0.2, abs=0.01)
    assert (gaps.missed_by > 0.002).mean() == pytest.approx(0.135, abs=0.01)
    assert gaps.share_close == pytest.approx(0.8, abs=0.01)
    missed, added = gaps.remarks()
    assert missed.startswith("13.") and "of the surface are not met by over 2 mm" in missed
    assert "of the collision shapes stand off by over 2 mm: 5.0 mm at (25, " in added


def test_what_is_missing_is_named_with_its_place() -> None:
    lug = manifold3d.Manifold.cube((0.008, 0.004, 0.004), True).translate((0.0, 0.024, 0.0))
    whole = RepairedSolid(CUBE.solid + lug.translate((0.0, -0.004, 0.0)) + lug.translate((0.0, 0.004, 0.0)), ())
    gaps = judge(whole, (Shape("box", (0.04, 0.04, 0.04)),))
    # The lug ends 10 mm above the cube's side at y = 20 mm.
    assert gaps.largest == pytest.approx(0.010, abs=2e-4)
    (remark,) = gaps.remarks()
    assert "not met" in remark and "10.0 mm at (" in remark and ", 30, " in remark
    assert gaps.added_by.max() < 0.0021


def test_samples_are_spread_by_area() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.03, 0.0], [0.0, 0.0, 0.001]])
    faces = np.array([[0, 1, 2], [0, 1, 3]])
    points, owner = surface_samples(vertices, faces, 0.001)
    assert abs((owner == 0).sum() - 450) <= 1 and abs((owner == 1).sum() - 15) <= 1
    assert np.abs(points[owner == 0, 2]).max() == 0.0 and (points[:, :2] >= 0.0).all()
    assert points[owner == 0].mean(axis=0) == pytest.approx((0.01, 0.01, 0.0), abs=2e-4)
    assert len(surface_samples(vertices, faces, 1.0)[0]) == 2


def test_distances_are_those_to_the_triangles() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.03, 0.0]])
    plate = SampledSurface(vertices, np.array([[0, 1, 2]]), 0.001)
    # Above the middle, beyond a corner, and in the plane beyond the long side.
    points = np.array([[0.01, 0.01, 0.003], [-0.0015, -0.002, 0.0], [0.016, 0.016, 0.0], [0.01, 0.01, 0.05]])
    assert plate.distances(points[:3]) == pytest.approx([0.003, 0.0025, 0.002 / 2**0.5], abs=1e-6)
    assert 0.05 <= plate.distances(points[3:])[0] < 0.0501
    assert len(plate.distances(np.zeros((0, 3)))) == 0
