"""On which faces an object rests."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.objects.resting import resting_rotations, turn_down


def test_a_box_rests_on_its_faces_and_rather_on_the_broad_ones() -> None:
    corners = np.array([[x, y, z] for x in (-0.02, 0.02) for y in (-0.05, 0.05) for z in (-0.1, 0.1)])
    R, share = resting_rotations(corners, np.zeros(3))
    height = -(R[:, 2] @ corners.T).min(axis=1)
    assert share.sum() == pytest.approx(1.0)
    assert height[share.argmax()] == pytest.approx(0.02)
    # Tipping angles: on the narrowest faces atan(0.02 / 0.1), on the broadest atan(0.05 / 0.02).
    assert share.max() / share[np.abs(height - 0.02) > 1e-9].min() <= 10.0 + 1e-9
    assert (np.abs(height - 0.1) > 1e-9).all()


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_turned_down(normal: tuple[float, float, float]) -> None:
    R = turn_down(np.array(normal))
    assert R @ normal == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_a_ball_rests_as_it_is_modelled() -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(400, 3))
    R, share = resting_rotations(ball / np.linalg.norm(ball, axis=1, keepdims=True), np.zeros(3))
    # No face of 400 points is broad enough to stand on.
    assert pytest.approx(np.eye(3)[None]) == R or share.sum() == pytest.approx(1.0)
