"""The catalogue's facts, and the objects of the release: made here in a folder, and the authors' own where they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.files.joblib import read_joblib_arrays
from dgrasp.objects.body import DETAILED_MESH, object_body
from dgrasp.objects.catalogue import CATALOGUE, LABEL_TYPES, CatalogueObject, catalogue_object
from dgrasp.objects.names import YCB_NAMES
from dgrasp.objects.release import release_object
from tests.reference import reference_or_skip


def test_catalogue_has_the_twenty_objects() -> None:
    assert {entry.id: entry.name for entry in CATALOGUE} == YCB_NAMES
    assert [entry.id for entry in CATALOGUE] == sorted(YCB_NAMES)


def test_masses_differ_for_five_objects() -> None:
    differing = [entry.name[:3] for entry in CATALOGUE if entry.mass_ycb != entry.mass_authors]
    assert differing == ["003", "006", "021", "040", "052"]
    bleach = catalogue_object("021_bleach_cleanser")
    assert (bleach.mass("ycb"), bleach.mass("official")) == (1.131, 0.302)


def test_kinds_of_collision_shape() -> None:
    kinds = {kind: [e.name[:3] for e in CATALOGUE if e.collision.kind == kind] for kind in LABEL_TYPES}
    assert kinds == {
        "cylinder": ["002", "005", "007"],
        "box": ["003", "004", "061"],
        "mesh": ["006", "011", "019", "021", "024", "025", "035", "037", "052"],
        "hull": ["008", "009", "010", "036", "040"],
    }


def test_unknown_object_is_a_data_error() -> None:
    with pytest.raises(DataError, match="004_sugar_box"):
        catalogue_object("sugar_bx")


def test_boxes_and_cylinders_need_no_files(tmp_path: Path) -> None:
    cracker = release_object(tmp_path, "003_cracker_box", "ycb", official_compat=False)
    assert cracker.shapes[0].size == (0.060, 0.158, 0.210) and cracker.mass == 0.411
    # I_x = m (y^2 + z^2) / 12.
    assert cracker.inertia[0, 0] == pytest.approx(0.411 * (0.158**2 + 0.210**2) / 12)
    can = release_object(tmp_path, "002_master_chef_can", "official", official_compat=False)
    assert can.shapes[0].kind == "cylinder" and can.shapes[0].size == (0.051, 0.139)
    assert can.inertia[2, 2] == pytest.approx(0.414 * 0.051**2 / 2)


def test_hull_of_a_mesh_file(tmp_path: Path) -> None:
    (tmp_path / "036_wood_block").mkdir()
    block = trimesh.creation.box((0.085, 0.085, 0.2))
    block.apply_translation((0.01, 0.0, -0.02))
    block.export(tmp_path / "036_wood_block" / "mesh_aligned.obj")
    model = release_object(tmp_path, "036_wood_block", "ycb", official_compat=False)
    assert model.shapes[0].kind == "hull"
    assert model.shapes[0].file == tmp_path / "036_wood_block" / "mesh_aligned.obj"
    assert model.center_of_mass_O == pytest.approx([0.01, 0.0, -0.02])
    assert model.inertia[2, 2] == pytest.approx(0.729 * 2 * 0.085**2 / 12)
    compatible = release_object(tmp_path, "036_wood_block", "ycb", official_compat=True)
    assert np.array_equal(compatible.center_of_mass_O, np.zeros(3)) and np.array_equal(compatible.inertia, np.eye(3))


def test_millimetres_are_refused(tmp_path: Path) -> None:
    (tmp_path / "036_wood_block").mkdir()
    file = tmp_path / "036_wood_block" / "mesh_aligned.obj"
    trimesh.creation.box((85.0, 85.0, 200.0)).export(file)
    with pytest.raises(DataError, match=r"mesh_aligned\.obj: its longest side is 200 m, the object's 0\.2 m"):
        release_object(tmp_path, "036_wood_block", "ycb", official_compat=True)
    trimesh.creation.box((0.085, 0.085, 0.2)).export(file)
    model = release_object(tmp_path, "036_wood_block", "ycb", official_compat=True)
    trimesh.creation.box((8.5, 8.5, 20.0)).export(file.with_name(DETAILED_MESH))
    with pytest.raises(DataError, match=r"textured_meshlab\.obj: its longest side is 20 m"):
        object_body(model, tmp_path)


@pytest.mark.parametrize("compat", [True, False])
@pytest.mark.parametrize(("name", "file"), [("025_mug", "textured_meshlab_quart"), ("008_pudding_box", "mesh_aligned")])
def test_missing_mesh_is_named(tmp_path: Path, name: str, file: str, compat: bool) -> None:
    with pytest.raises(DataError, match=rf"{name}/{file}\.obj: the collision mesh of {name} is missing"):
        release_object(tmp_path, name, "official", official_compat=compat)


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: entry.name)
def test_authors_objects(entry: CatalogueObject) -> None:
    model = release_object(reference_or_skip() / "objects", entry.name, "official", official_compat=False)
    assert model.name == entry.name and model.mass == entry.mass_authors
    assert model.inertia == pytest.approx(model.inertia.T)
    low, middle, high = np.linalg.eigvalsh(model.inertia)
    assert low > 0 and high <= low + middle
    # No body has a larger moment than two lumps at the ends of its bounding box's diagonal.
    assert high <= model.mass * (np.linalg.norm(entry.extents) / 2) ** 2
    assert np.abs(model.center_of_mass_O).max() < 0.03


def test_label_files_agree_with_the_catalogue() -> None:
    labels = read_joblib_arrays(reference_or_skip() / "labels" / "dexycb_train_labels.pkl")
    assert sorted(labels) == [entry.id for entry in CATALOGUE]
    for entry in CATALOGUE:
        record = labels[entry.id]
        assert np.all(record["obj_w_stacked"] == entry.mass_authors)
        assert np.all(record["obj_type_stacked"] == LABEL_TYPES.index(entry.collision.kind))
        if entry.collision.size:
            n = len(entry.collision.size)
            assert np.all(record["obj_dim_stacked"][:, :n] == entry.collision.size)
