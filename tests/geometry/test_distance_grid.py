"""The distance to a union of bodies on a grid."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.geometry.distance_grid import distance_grid, triangle_distances
from dgrasp.geometry.intersection import body
from dgrasp.geometry.shape_mesh import shape_mesh
from raisim_like.shapes import Shape
from tests.labels.distances import signed_distance


def test_distance_to_a_triangle() -> None:
    triangle = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    points = np.array([[1.0, 1.0, 2.0], [-3.0, -4.0, 0.0], [2.0, -1.0, 0.0], [3.0, 3.0, 0.0], [4.0, 0.0, -1.0]])
    expected = [2.0, 5.0, 1.0, 2.0**0.5, 1.0]
    assert triangle_distances(np.repeat(triangle[None], 5, 0), points) == pytest.approx(expected, abs=1e-12)


def test_the_grid_has_the_distances_of_a_union() -> None:
    # Two overlapping boxes: x from -0.03 to 0.05, y and z from -0.02 to 0.02.
    shapes = [Shape("box", (0.06, 0.04, 0.04)), Shape("box", (0.06, 0.04, 0.04), position=(0.02, 0.0, 0.0))]
    grid = distance_grid(body([shape_mesh(shape) for shape in shapes]), pitch=0.004)
    low, high = grid.low, grid.high
    assert (low < [-0.06, -0.05, -0.05]).all() and (high > [0.08, 0.05, 0.05]).all()
    axes = [low[k] + grid.pitch * np.arange(grid.values.shape[k]) for k in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    whole = [Shape("box", (0.08, 0.04, 0.04), position=(0.01, 0.0, 0.0))]
    expected = signed_distance(whole, points)
    near = np.abs(expected) < 0.018
    assert grid.values[near] == pytest.approx(expected[near], abs=1e-9)
    assert (grid.values - expected).min() > -1e-9 and (grid.values - expected).max() < 0.004
