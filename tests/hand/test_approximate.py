"""Primitives and hulls for part meshes: shapes that are known come back, overlaps are what they are called."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.geometry.approximate import fit_box, fit_capsule, fit_hull, overlap, part_properties
from dgrasp.geometry.part_mesh import PartMesh
from dgrasp.hand.mano.skeleton import PARTS
from dgrasp.hand.store import open_hand
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape
from tests.reference import reference_or_skip

TILT = trimesh.transformations.euler_matrix(0.4, -0.7, 1.1)
TILT[:3, 3] = [0.03, -0.02, 0.01]


def part(mesh: trimesh.Trimesh) -> PartMesh:
    return PartMesh("part", np.asarray(mesh.vertices, float), np.asarray(mesh.faces))


def test_a_capsule_is_found_again() -> None:
    mesh = trimesh.creation.capsule(height=0.03, radius=0.008, count=[16, 16]).apply_transform(TILT)
    fit = fit_capsule(part(mesh))
    assert fit_capsule(part(mesh)) == fit
    assert fit.overlap > 0.94
    assert fit.shape.size == pytest.approx((0.008, 0.03), abs=6e-4)
    assert fit.shape.position == pytest.approx(mesh.center_mass, abs=4e-4)
    axis = matrix_from_quaternion(np.array(fit.shape.quaternion))[:, 2]
    assert abs(axis @ TILT[:3, 2]) > math.cos(0.03)


@pytest.mark.parametrize("size", [(0.09, 0.025, 0.07), (0.08, 0.02, 0.08)])
def test_a_box_is_found_again_also_a_square_one(size: tuple[float, float, float]) -> None:
    mesh = trimesh.creation.box(size).apply_transform(TILT)
    fit = fit_box(part(mesh))
    assert fit.overlap > 0.93
    assert sorted(fit.shape.size) == pytest.approx(sorted(size), abs=2.5e-3)


def test_the_overlap_of_known_solids() -> None:
    box = part(trimesh.creation.box((0.04, 0.04, 0.04)))
    assert overlap(Shape("box", (0.04, 0.04, 0.04)), box) == pytest.approx(1.0, abs=1e-6)
    # Shifted by half: a third of the union is common. A thin slab between no grid's layers: its share of the volume.
    assert overlap(Shape("box", (0.04, 0.04, 0.04), (0.02, 0.0, 0.0)), box) == pytest.approx(1 / 3, abs=0.01)
    for thickness in (0.001, 0.0023, 0.013):
        share = overlap(Shape("box", (0.04, thickness, 0.04)), box)
        assert share == pytest.approx(thickness / 0.04, abs=0.003)
    assert overlap(Shape("sphere", (0.02,)), box) == pytest.approx(math.pi / 6, abs=0.01)


def test_a_hull_and_its_overlap(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    block = box.copy().apply_translation([0.02, 0.0, 0.0])
    corner = trimesh.util.concatenate([box, block, box.copy().apply_translation([0.0, 0.02, 0.0])])
    fit, hull = fit_hull(part(corner), tmp_path / "hull.obj")
    # Three cubes of an L, and the prism of half a cube that its hull adds.
    assert fit.overlap == pytest.approx(3.0 / 3.5, rel=1e-6)
    assert hull.volume == pytest.approx(3.5 * 8e-6, rel=1e-9)
    assert trimesh.Trimesh(hull.vertices, hull.faces, process=False).is_volume
    assert fit.shape == Shape("hull", file=tmp_path / "hull.obj")


def test_mass_properties_of_a_box() -> None:
    found = part_properties(part(trimesh.creation.box((0.02, 0.03, 0.04)).apply_translation([0.1, 0.0, 0.0])))
    assert found.volume == pytest.approx(24e-6) and found.center_of_mass == pytest.approx([0.1, 0, 0])
    assert np.diag(found.inertia_of(12.0)) == pytest.approx([25e-4, 20e-4, 13e-4])


def test_flat_parts_are_refused(tmp_path: Path) -> None:
    flat = PartMesh("palm", np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    with pytest.raises(DataError, match="palm is flat"):
        fit_hull(flat, tmp_path / "x.obj")
    with pytest.raises(DataError, match="palm is too thin"):
        fit_box(flat)


def test_fits_beat_the_authors_primitives() -> None:
    folder = reference_or_skip() / "hand"
    authors = open_hand(str(folder / "mano_mean.urdf")).model
    for name, file in (("index_middle", "ffmiddle"), ("ring_proximal", "rfprox"), ("thumb_distal", "thdist")):
        mesh = trimesh.load(folder / "meshes" / f"{file}_mean.stl")
        mesh.merge_vertices()
        theirs = authors.urdf.links[authors.part_links[PARTS.index(name)]].shapes
        assert len(theirs) == 1
        ours = fit_capsule(part(mesh))
        assert ours.overlap > 0.8 > 0.7 > overlap(theirs[0], part(mesh)), name
