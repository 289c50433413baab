"""Rotations against scipy, which writes quaternions x, y, z, w and intrinsic angles in capitals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from raisim_like.rotations import (
    euler_from_matrix,
    matrix_from_euler,
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotate,
    rotate_back,
    transform,
)

ANGLES = np.random.default_rng(5).uniform(-np.pi, np.pi, (40, 3))
MATRICES = Rotation.random(60, random_state=2).as_matrix()


def test_matrix_from_euler_is_rx_ry_rz() -> None:
    expected = Rotation.from_euler("XYZ", ANGLES).as_matrix()
    assert np.abs(matrix_from_euler(ANGLES) - expected).max() < 1e-14


def test_euler_from_matrix_as_scipy_reads_it() -> None:
    expected = Rotation.from_matrix(MATRICES).as_euler("XYZ")
    assert np.abs(euler_from_matrix(MATRICES) - expected).max() < 1e-9


def test_euler_angles_survive_a_round_trip_within_half_a_turn_about_y() -> None:
    angles = ANGLES * [1.0, 0.49, 1.0]
    assert np.abs(euler_from_matrix(matrix_from_euler(angles)) - angles).max() < 1e-9


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("short_of_lock", [0.0, 1e-9, 1e-7, 1e-5, 1e-3])
def test_near_the_gimbal_lock_the_angles_still_give_the_matrix(sign: float, short_of_lock: float) -> None:
    R = matrix_from_euler(np.array([[0.7, sign * (np.pi / 2 - short_of_lock), -0.4]]))
    angles = euler_from_matrix(R)
    # Angles count as locked from sin b = 1 - 1e-12 on, where cos b = 1.4e-6; that much of the third may be lost.
    assert np.abs(matrix_from_euler(angles) - R).max() < 1.5e-6
    if short_of_lock == 0.0:
        assert angles[0, 2] == 0.0


def test_quaternions_are_w_x_y_z() -> None:
    quarter_about_z = np.array([np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4)])
    assert np.allclose(matrix_from_quaternion(quarter_about_z) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    expected = Rotation.from_matrix(MATRICES).as_quat(canonical=True)[:, [3, 0, 1, 2]]
    assert np.abs(quaternion_from_matrix(MATRICES) - expected).max() < 1e-14
    assert np.abs(matrix_from_quaternion(expected) - MATRICES).max() < 1e-14


def test_quaternions_need_not_be_normalised() -> None:
    q = np.array([[2.0, 1.0, -3.0, 0.5]])
    assert np.abs(matrix_from_quaternion(q) - Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()).max() < 1e-14


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.8, 0), (0.5, -0.5, np.sqrt(0.5))])
def test_half_turns_where_w_is_zero(axis: tuple[float, ...]) -> None:
    R = Rotation.from_rotvec(np.pi * np.array(axis)).as_matrix()
    q = quaternion_from_matrix(R)
    assert np.abs(np.abs(q[1:]) - np.abs(axis)).max() < 1e-12
    assert np.abs(matrix_from_quaternion(q) - R).max() < 1e-12


def test_shapes_are_kept_for_any_batch() -> None:
    angles = np.zeros((2, 5, 3))
    assert matrix_from_euler(angles).shape == (2, 5, 3, 3)
    assert euler_from_matrix(matrix_from_euler(angles)).shape == (2, 5, 3)
    assert quaternion_from_matrix(matrix_from_euler(angles)).shape == (2, 5, 4)
    assert quaternion_from_matrix(np.eye(3)).tolist() == [1.0, 0.0, 0.0, 0.0]


def test_rotate_and_back() -> None:
    v = np.random.default_rng(0).normal(size=(60, 3))
    expected = Rotation.from_matrix(MATRICES).apply(v)
    assert np.abs(rotate(MATRICES, v) - expected).max() < 1e-14
    assert np.abs(rotate_back(MATRICES, expected) - v).max() < 1e-14


def test_transform_maps_points() -> None:
    T = transform(MATRICES[:2], np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))
    point = np.array([0.3, -0.2, 0.1, 1.0])
    assert np.allclose((T @ point)[1], [*(MATRICES[1] @ point[:3] + [4, 5, 6]), 1.0], atol=1e-15)


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[st.floats(-20, 20)] * 3))
def test_any_angles_give_a_rotation(angles: tuple[float, float, float]) -> None:
    R = matrix_from_euler(np.array(angles))
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
    assert abs(np.linalg.det(R) - 1.0) < 1e-14
    assert np.abs(matrix_from_euler(euler_from_matrix(R)) - R).max() < 2e-6
