from __future__ import annotations

import numpy as np
import pytest

from dgrasp.errors import DataError
from dgrasp.geometry.closing import close_mesh, is_closed, signed_volume
from tests.geometry.solids import box, tube


def test_a_closed_mesh_stays_as_it_is() -> None:
    vertices, faces = box((0.02, 0.03, 0.05))
    closed = close_mesh(vertices, faces)
    assert closed.holes == 0 and len(closed.vertices) == 8 and len(closed.faces) == 12
    assert closed.volume == pytest.approx(3e-5)


def test_vertices_that_are_repeated_per_face_are_merged() -> None:
    vertices, faces = box((0.02, 0.03, 0.05))
    loose, numbered = vertices[faces].reshape(-1, 3), np.arange(36).reshape(12, 3)
    assert not is_closed(numbered, 36)
    closed = close_mesh(loose, numbered)
    assert closed.holes == 0 and len(closed.vertices) == 8 and closed.volume == pytest.approx(3e-5)


def test_flat_holes_are_capped_exactly() -> None:
    # A prism over a regular polygon of 48 corners: area n r^2 sin(2 pi / n) / 2.
    vertices, faces = tube(0.01, 0.04)
    assert not is_closed(faces, len(vertices))
    closed = close_mesh(vertices, faces)
    assert closed.holes == 2 and is_closed(closed.faces, len(closed.vertices))
    assert closed.volume == pytest.approx(24 * 1e-4 * np.sin(2 * np.pi / 48) * 0.04, rel=1e-12)


def test_a_mesh_wound_inwards_is_turned() -> None:
    vertices, faces = box((0.02, 0.03, 0.05))
    assert signed_volume(vertices, faces[:, ::-1]) == pytest.approx(-3e-5)
    assert close_mesh(vertices, faces[:, ::-1]).volume == pytest.approx(3e-5)


def test_volume_does_not_depend_on_the_place() -> None:
    vertices, faces = tube(0.01, 0.04)
    far = close_mesh(vertices + np.array([3.0, -2.0, 5.0]), faces)
    assert far.volume == pytest.approx(close_mesh(vertices, faces).volume, rel=1e-9)


def test_faces_that_have_no_area_are_left_out() -> None:
    vertices, faces = box((0.02, 0.03, 0.05))
    extra = np.concatenate([faces, [[0, 0, 1], [2, 2, 2]]])
    assert len(close_mesh(vertices, extra).faces) == 12


def test_what_encloses_nothing_is_refused() -> None:
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    for faces in ([[0, 1, 2], [0, 2, 3]], np.zeros((0, 3))):
        with pytest.raises(DataError, match="encloses no volume"):
            close_mesh(flat, np.array(faces))
