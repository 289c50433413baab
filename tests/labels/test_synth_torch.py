"""The hand and the distance to an object as the descent sees them, against numpy and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.geometry.distance_grid import distance_grid
from dgrasp.geometry.intersection import body
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.synthesis.torch_hand import ObjectField, TorchHand, tensor
from raisim_like.rotations import matrix_from_euler
from raisim_like.shapes import Shape
from tests.scenes import free_hand


def test_the_field_interpolates_and_goes_on_beyond_its_grid() -> None:
    brick = body([shape_mesh(Shape("box", (0.050, 0.075, 0.050)))])
    field = ObjectField(distance_grid(brick, pitch=0.006))
    points = tensor(np.array([[0.030, 0.0, 0.0], [0.020, 0.0, 0.0], [0.0, 0.0, 0.525]]))
    distance, normal = field.with_normal(points)
    assert distance.numpy() == pytest.approx([0.005, -0.005, 0.500], abs=5e-4)
    assert normal.numpy() == pytest.approx(np.array([[1, 0, 0], [1, 0, 0], [0, 0, 1]]), abs=0.02)


def test_kinematics_are_those_of_numpy() -> None:
    hand, rng = TorchHand(free_hand()), np.random.default_rng(0)
    pose, T = rng.uniform(-0.5, 0.5, (3, 45)), np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = matrix_from_euler(rng.uniform(-1, 1, (3, 3))), rng.normal(size=(3, 3))
    posed = hand.forward(tensor(T[:, :3, :3]), tensor(T[:, :3, 3]), tensor(pose))
    R, t = hand.model.part_poses(T, pose)
    assert np.abs(posed.R.numpy() - R).max() < 1e-5 and np.abs(posed.t.numpy() - t).max() < 1e-5
    assert np.abs(posed.centers.numpy() - hand.spheres.place(R, t)).max() < 1e-5
    gc = np.concatenate([np.zeros((3, 6)), pose], axis=1)
    _, joints = hand.model.forward(gc, T[:, :3, :3], T[:, :3, 3])
    assert np.abs(hand.tips(posed).numpy() - joints[:, 4::4]).max() < 1e-5
