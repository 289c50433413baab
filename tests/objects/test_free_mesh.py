"""The free objects' meshes: closed, of the published sizes, close to what is simulated, and as they ship."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.geometry.inertia import load_mesh
from dgrasp.geometry.intersection import body
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.objects.catalogue import CATALOGUE, CatalogueObject, catalogue_object
from dgrasp.objects.free import free_object
from dgrasp.objects.free_mesh import free_mesh, main
from tests.labels.distances import signed_distance

each_object = pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: entry.name)
HANDLES = {"019_pitcher_base": 1, "025_mug": 1, "037_scissors": 2}
"""Number of holes through an object."""
SHELLS = ("019_pitcher_base", "024_bowl", "025_mug")


@each_object
def test_closed_and_of_the_published_size(entry: CatalogueObject) -> None:
    vertices, faces = free_mesh(entry.name)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0 and mesh.body_count == 1
    assert vertices.max(axis=0) == pytest.approx(np.array(entry.extents) / 2, abs=1.5e-6)
    assert vertices.min(axis=0) == pytest.approx(-np.array(entry.extents) / 2, abs=1.5e-6)
    assert len(faces) < 4000 and 0.02 < mesh.volume / np.prod(entry.extents) <= 1.0 + 1e-6
    solid = body([(vertices, faces)]).solid
    assert solid is not None and solid.genus() == HANDLES.get(entry.name, 0)


@each_object
def test_close_to_what_is_simulated(entry: CatalogueObject) -> None:
    model = free_object(entry.name, "official", False)
    vertices, faces = free_mesh(entry.name)
    mine, simulated = body([(vertices, faces)]).solid, body([shape_mesh(shape) for shape in model.shapes]).solid
    common = (mine ^ simulated).volume()
    # Walls of 5 mm, round in one and flat in the other, overlap less than solids do.
    assert common / (mine.volume() + simulated.volume() - common) > (0.7 if entry.name in SHELLS else 0.77)
    # No difference between the two that a finger could meet is larger than a fingertip.
    assert signed_distance(model.shapes, vertices).max() < 0.0072
    assert mine.volume() == pytest.approx(simulated.volume(), rel=0.12)


@each_object
def test_files_are_what_the_code_makes(entry: CatalogueObject) -> None:
    model = free_object(entry.name, "official", False)
    assert model.mesh is not None
    shipped = load_mesh(model.mesh)
    vertices, faces = free_mesh(entry.name)
    made = trimesh.Trimesh(vertices, faces, process=False)
    assert shipped.is_watertight and shipped.extents == pytest.approx(made.extents, abs=2e-6)
    assert shipped.volume == pytest.approx(made.volume, rel=1e-3)
    assert shipped.center_mass == pytest.approx(made.center_mass, abs=1e-4)


def test_volumes_by_hand() -> None:
    def volume(name: str) -> float:
        return float(trimesh.Trimesh(*free_mesh(name), process=False).volume)

    assert volume("004_sugar_box") == pytest.approx(0.038 * 0.089 * 0.175)
    # A cylinder minus two lids, 1.5 mm deep and of a radius 2.5 mm smaller; corners of a circle cost half a percent.
    can = math.pi * (0.051**2 * 0.139 - 2 * 0.0015 * 0.0485**2)
    assert volume("002_master_chef_can") == pytest.approx(can, rel=5e-3)
    # Two sides 47 mm long and two half discs of 25 mm.
    tin = (0.047 * 0.05 + math.pi * 0.025**2) * 0.089 - 0.003 * (0.047 * 0.045 + math.pi * 0.0225**2)
    assert volume("010_potted_meat_can") == pytest.approx(tin, rel=5e-3)


def test_vessels_are_hollow() -> None:
    for name, inside in (("025_mug", (-0.0115, 0.0, 0.0)), ("019_pitcher_base", (-0.014, -0.012, 0.05)),
                         ("024_bowl", (0.0, 0.0, 0.0))):  # fmt: skip
        vertices, faces = free_mesh(name)
        ball = trimesh.creation.icosphere(2, 0.02)
        held = body([(np.asarray(ball.vertices) + inside, np.asarray(ball.faces))]).solid
        assert (body([(vertices, faces)]).solid ^ held).volume() == pytest.approx(0.0, abs=1e-12), name
        bottom = np.array([*inside[:2], -catalogue_object(name).extents[2] / 2 + 0.003])
        touching = body([(np.asarray(ball.vertices) * 0.05 + bottom, np.asarray(ball.faces))]).solid
        assert (body([(vertices, faces)]).solid ^ touching).volume() == pytest.approx(touching.volume(), rel=1e-3), name


def test_the_same_bytes_every_time(tmp_path: Path) -> None:
    assert main(["--out", str(tmp_path / "a")]) == 0
    written = {path.parent.name: path.read_bytes() for path in (tmp_path / "a").rglob("mesh.obj")}
    assert sorted(written) == [entry.name for entry in CATALOGUE]
    for name in ("025_mug", "037_scissors"):
        again, _ = free_mesh(name)
        assert written[name].startswith("v {:.9g} {:.9g} {:.9g}\n".format(*again[0]).encode())
    with pytest.raises(DataError, match="unknown object"):
        free_mesh("051_large_clamp")
