"""Whether contacts can hold an object's weight by friction."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.geometry.equilibrium import MAX_FORCE, holds_weight

UP = np.array([0.0, 0.0, 1.0])
CENTER = np.zeros(3)
PINCH = np.array([[0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]])
OUTWARD = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])


def wedge(degrees: float) -> np.ndarray:
    """Normals of two faces that lean towards each other by as much, narrower above."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0.0, s], [-c, 0.0, s]])


def test_nothing_holds_nothing() -> None:
    assert not holds_weight(np.zeros((0, 3)), np.zeros((0, 3)), CENTER, UP, 0.8)


def test_one_contact_holds_what_lies_on_it() -> None:
    below, outward = np.array([[0.0, 0.0, -0.05]]), np.array([[0.0, 0.0, -1.0]])
    assert holds_weight(below, outward, CENTER, UP, 0.0)
    assert not holds_weight(below, outward, CENTER, -UP, 0.8)
    # Beside the centre it would turn about the contact.
    assert not holds_weight(below + np.array([0.02, 0.0, 0.0]), outward, CENTER, UP, 0.8)


def test_two_opposed_contacts_need_friction_and_their_centre_in_line() -> None:
    assert holds_weight(PINCH, OUTWARD, CENTER, UP, 0.3)
    assert not holds_weight(PINCH, OUTWARD, CENTER, UP, 0.0)
    # Weight beside the line between two points turns the object about it.
    assert not holds_weight(PINCH + np.array([0.0, 0.02, 0.0]), OUTWARD, CENTER, UP, 0.8)


@pytest.mark.parametrize("angle", [10.0, 20.0, 35.0])
def test_a_wedge_slips_out_below_the_tangent_of_its_angle(angle: float) -> None:
    """Faces that lean push an object down; friction of the angle's tangent balances that, and some more its weight."""
    enough = np.tan(np.radians(angle))
    assert not holds_weight(PINCH, wedge(angle), CENTER, UP, 0.97 * enough)
    # Lift per unit of normal force is mu cos - sin of each face; its sum is bounded.
    bound = (np.sin(np.radians(angle)) + 1.0 / MAX_FORCE) / np.cos(np.radians(angle))
    assert not holds_weight(PINCH, wedge(angle), CENTER, UP, bound - 0.01)
    assert holds_weight(PINCH, wedge(angle), CENTER, UP, bound + 0.01)
    # Upside down the same faces carry it without friction.
    assert holds_weight(PINCH, wedge(angle), CENTER, -UP, 0.0)


def test_the_frame_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(scale=0.03, size=(6, 3))
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for friction in (0.05, 0.6):
        turned = holds_weight(points @ R.T + 1.0, normals @ R.T, CENTER + 1.0, R @ UP, friction)
        assert turned == holds_weight(points, normals, CENTER, UP, friction)
