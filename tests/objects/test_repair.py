"""Repairs: what is mended, what is rebuilt, what is refused. Volumes worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.objects.add import rebuild
from dgrasp.objects.add.repair import RepairedSolid, repair
from tests.objects.meshes import VOLUME, box, joined, plain


def mended(mesh: trimesh.Trimesh) -> RepairedSolid:
    solid = repair(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    whole = trimesh.Trimesh(*solid.mesh, process=False)
    assert whole.is_watertight and whole.is_winding_consistent
    assert whole.volume == pytest.approx(solid.solid.volume()) and whole.volume > 0
    return solid


def volume(mesh: trimesh.Trimesh) -> float:
    return float(mended(mesh).solid.volume())


def test_a_sound_mesh_stays_as_it_is() -> None:
    solid = mended(box())
    assert solid.solid.volume() == pytest.approx(VOLUME) and len(solid.mesh[1]) == 12 and solid.notes == ()


def test_a_torus_keeps_its_hole() -> None:
    solid = mended(trimesh.creation.torus(0.05, 0.015, major_sections=64, minor_sections=32))
    # 2 pi^2 R r^2, and its polygons inside both circles.
    assert solid.solid.volume() == pytest.approx(2 * np.pi**2 * 0.05 * 0.015**2, rel=0.02)
    assert solid.solid.genus() == 1 and solid.notes == ()


def test_flipped_normals_and_loose_triangles() -> None:
    inverted = box()
    inverted.invert()
    assert mended(inverted).notes == ("normals turned outwards",) and volume(inverted) == pytest.approx(VOLUME)
    faces = box().faces.copy()
    faces[::2] = faces[::2, ::-1]
    assert volume(plain(box().vertices, faces)) == pytest.approx(VOLUME)
    # An STL has three vertices of its own for each triangle.
    loose = plain(box().vertices[box().faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert mended(loose).notes == ("28 duplicate vertices merged",) and volume(loose) == pytest.approx(VOLUME)
    double = plain(box().vertices, np.concatenate([box().faces, box().faces, [[0, 0, 1]]]))
    assert mended(double).notes == ("13 duplicate or empty faces removed",) and volume(double) == pytest.approx(VOLUME)


def test_holes_are_closed_up_to_a_fifth_of_the_surface() -> None:
    cube = trimesh.creation.box((0.04, 0.04, 0.04))
    one_face = plain(cube.vertices, cube.faces[cube.face_normals[:, 2] < 0.5])
    solid = mended(one_face)
    # The missing side is a fifth of the five that are there.
    assert solid.solid.volume() == pytest.approx(0.04**3) and solid.notes == ("1 hole closed (20.0% of the surface)",)
    ball = trimesh.creation.icosphere(3, 0.03)
    holed = plain(ball.vertices, ball.faces[20:])
    assert volume(holed) == pytest.approx(ball.volume, rel=2e-3) and "hole" in mended(holed).notes[0]


def test_overlapping_pieces_count_once_and_cavities_are_left_out() -> None:
    # Two boxes, the second half a length along x: 1.5 times one of them.
    assert volume(joined(box(), box(center=(0.03, 0.0, 0.0)))) == pytest.approx(1.5 * VOLUME)
    cube = trimesh.creation.box((0.02, 0.02, 0.02))
    assert volume(joined(box(), cube)) == pytest.approx(VOLUME)
    cube.invert()
    hollow = joined(box(), cube)
    assert mended(hollow).notes == ("1 cavity inside",) and volume(hollow) == pytest.approx(VOLUME - 8e-6)
    hollow.invert()
    assert volume(hollow) == pytest.approx(VOLUME - 8e-6)


def test_an_edge_of_three_faces() -> None:
    fin = plain(np.vstack([box().vertices, [[0.05, 0.0, 0.09]]]), np.vstack([box().faces, [[6, 7, 8]]]))
    assert mended(fin).notes == ("1 faces removed that stood off at an edge",) and volume(fin) == pytest.approx(VOLUME)
    two = joined(trimesh.creation.box((0.04, 0.04, 0.04)), box((0.04, 0.04, 0.04), (0.0, 0.04, 0.04)))
    two.merge_vertices()
    assert volume(two) == pytest.approx(2 * 0.04**3)


def test_a_non_manifold_scan_is_built_anew() -> None:
    """Two cubes with the wall between them, vertices shared, and one triangle missing."""
    both = joined(box((0.04, 0.04, 0.04)), box((0.04, 0.04, 0.04), (0.0, 0.0, 0.04)))
    both.merge_vertices()
    _, first = np.unique(np.sort(both.faces, axis=1), axis=0, return_index=True)
    solid = mended(plain(both.vertices, both.faces[np.sort(first)]))
    # Cells of 0.08 / 64 m: the surface is off by less than one.
    assert solid.solid.volume() == pytest.approx(2 * 0.04**3, rel=0.04)
    assert "built anew on a grid of 1.2 mm" in solid.notes[-1]
    assert np.ptp(solid.mesh[0], axis=0) == pytest.approx((0.04, 0.04, 0.08), abs=1.3e-3)


def test_loose_triangles_that_do_not_quite_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rebuild, "CELLS", 32)
    ball = trimesh.creation.icosphere(3, 0.03)
    corners = ball.vertices[ball.faces] + np.random.default_rng(0).normal(0.0, 5e-5, (1280, 3, 3))
    solid = mended(plain(corners.reshape(-1, 3), np.arange(3 * 1280).reshape(-1, 3)))
    assert "1280 loose pieces" in solid.notes[-1] and solid.solid.volume() == pytest.approx(ball.volume, rel=0.03)


def test_a_thin_sheet() -> None:
    # With a thickness it is a body like any other.
    assert volume(box((0.2, 0.15, 0.0005))) == pytest.approx(0.2 * 0.15 * 0.0005)
    square = plain(np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    with pytest.raises(DataError, match="fewer than four faces"):
        mended(square)
    with pytest.raises(DataError, match=r"the mesh is flat.*thickness"):
        mended(square.subdivide())


def test_a_surface_without_an_inside_is_refused() -> None:
    ball = trimesh.creation.icosphere(3, 0.05)
    half = plain(ball.vertices, ball.faces[ball.triangles_center[:, 2] > 0])
    with pytest.raises(DataError, match=r"no grid finds an inside.*give it a thickness"):
        mended(half)


def test_nothing_to_repair() -> None:
    with pytest.raises(DataError, match="fewer than four faces"):
        repair(np.zeros((3, 3)), np.array([[0, 1, 2]]))
