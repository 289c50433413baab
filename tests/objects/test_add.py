"""From a mesh file to an object in a folder: mass, cache, what is written and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from dgrasp.errors import DataError
from dgrasp.files.paths import data_root
from dgrasp.objects.add import add
from dgrasp.objects.add.add import Mass, add_object
from dgrasp.objects.add.repair import RepairedSolid
from dgrasp.objects.body import object_body
from dgrasp.objects.store import META_FILE, default_store, find_object, load_object, object_id
from dgrasp.types import Array
from tests.objects.meshes import SIZE, VOLUME, box, save


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One cache for all tests here, because most of them do not depend on its content."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def use_shared(shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DGRASP_CACHE", str(shared))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A box in millimetres, away from its origin."""
    return save(box(center=(0.01, 0.0, 0.0)), tmp_path / "box.stl", 1000.0)


def add_box(file: Path, to: Path, name: str = "box", mass: Mass | None = None, replace: bool = False) -> add.Added:
    return add_object(file, to, name, "mm", mass, "box", replace=replace)


def test_mass_and_inertia_by_density(file: Path, tmp_path: Path) -> None:
    added = add_box(file, tmp_path / "objects")
    model = load_object(added.folder, official_compat=False)
    # 120 cm3 at 500 kg/m3; I = m / 12 (b^2 + c^2).
    assert model.name == "box" and model.mass == pytest.approx(0.06) and added.meta["source"]["units"] == "mm"
    assert model.center_of_mass_O == pytest.approx((0.01, 0.0, 0.0), abs=1e-8)
    x, y, z = (side**2 for side in SIZE)
    assert model.inertia == pytest.approx(0.06 / 12 * np.diag([y + z, x + z, x + y]), abs=1e-10)
    (shape,) = model.shapes
    assert shape.kind == "box" and shape.position == pytest.approx((0.01, 0.0, 0.0), abs=1e-6)
    assert object_body(model, tmp_path / "nowhere").body.solid.volume() == pytest.approx(VOLUME, rel=1e-4)
    compatible = load_object(added.folder, official_compat=True)
    assert np.array_equal(compatible.inertia, np.eye(3)) and compatible.center_of_mass_O[0] == pytest.approx(0.01)


def test_a_folder_that_cannot_be_written(file: Path, tmp_path: Path) -> None:
    (tmp_path / "blocked").write_text("a file")
    with pytest.raises(DataError, match=r"blocked/box: cannot be written \(.*\); choose another folder with --to"):
        add_box(file, tmp_path / "blocked")


def test_mass_center_and_inertia_given(file: Path, tmp_path: Path) -> None:
    mass = Mass(0.3, center=np.array([0.02, 0.0, 0.01]), inertia=np.diag([1e-4, 2e-4, 2.5e-4]))
    model = load_object(add_box(file, tmp_path, "heavy", mass).folder, official_compat=False)
    assert model.mass == 0.3 and model.center_of_mass_O.tolist() == [0.02, 0.0, 0.01]
    assert np.diag(model.inertia).tolist() == [1e-4, 2e-4, 2.5e-4]
    by_mass = load_object(add_box(file, tmp_path, "by_mass", Mass(0.12)).folder, official_compat=False)
    assert by_mass.inertia[0, 0] == pytest.approx(0.12 / 12 * (0.05**2 + 0.04**2), rel=1e-4)
    assert add_box(file, tmp_path, "dense", Mass(density=1000.0)).meta["mass_kg"] == pytest.approx(0.12)


@pytest.mark.parametrize(
    ("mass", "reason"),
    [
        (Mass(0.0), "a mass of 0 kg"),
        (Mass(1e4), "expected 0.1 g to 100 kg"),
        (Mass(density=float("inf")), "a mass of inf kg"),
        (Mass(center=np.array([0.5, 0.0, 0.0])), "the centre of mass .* lies outside"),
        (Mass(inertia=np.diag([1.0, 1.0, 3.0])), "no body has the principal moments 1, 1, 3"),
        (Mass(inertia=np.diag([1.0, 1.0, -1.0])), "no body has the principal moments"),
        (Mass(inertia=np.full((3, 3), np.nan)), "not a symmetric matrix"),
    ],
)
def test_masses_that_no_body_has(file: Path, tmp_path: Path, mass: Mass, reason: str) -> None:
    with pytest.raises(DataError, match=reason):
        add_box(file, tmp_path / "objects", mass=mass)
    assert not (tmp_path / "objects").exists()


@pytest.mark.parametrize("moment", [1e-14, 0.1])
def test_moments_that_the_size_cannot_have(file: Path, tmp_path: Path, moment: float) -> None:
    """60 x 50 x 40 mm about x: a solid has 0.5 / 12 (0.05^2 + 0.04^2), mass at edges 0.5 (0.025^2 + 0.02^2)."""
    with pytest.raises(DataError, match=r"principal moment of .*e-14|principal moment of 0\.1") as error:
        add_box(file, tmp_path / "objects", mass=Mass(0.5, inertia=np.diag([moment, moment, moment])))
    message = str(error.value)
    assert "expected 1.71e-06 to 0.00051" in message and "for 0.5 kg" in message and "has 0.000171" in message
    assert not (tmp_path / "objects").exists()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        # 0.06 kg, 60 x 50 x 40 mm: 0.06 (1e-5)^2, and 0.06 (0.06^2 + 0.05^2 + 0.04^2).
        ({"inertia": (1e-14 * np.eye(3)).tolist()}, "1e-14 kg m^2; expected 6e-12 to 0.000462 for 0.06 kg"),
        ({"inertia": np.eye(3).tolist()}, "a principal moment of 1 kg m^2"),
        ({"center_of_mass_O": [0.5, 0.0, 0.0]}, "the centre of mass [0.5, 0.0, 0.0] lies outside the object"),
        ({"mass_kg": 1000.0}, "a mass of 1000 kg; expected 0.1 g to 100 kg"),
    ],
)
def test_a_description_made_by_hand(file: Path, tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    path = add_box(file, tmp_path).folder / META_FILE
    meta = json.loads(path.read_text()) | change
    path.write_text(json.dumps(meta | {"id": object_id(meta)}))
    with pytest.raises(DataError, match=re.escape(reason)):
        load_object(path.parent, official_compat=False)


def test_moments_of_a_hollow_and_of_a_dense_body_are_taken(file: Path, tmp_path: Path) -> None:
    solid = 0.5 / 12 * np.array([0.05**2 + 0.04**2, 0.06**2 + 0.04**2, 0.06**2 + 0.05**2])
    for name, share in (("hollow", 1.6), ("true", 1.0), ("dense", 0.05)):
        mass = Mass(0.5, center=np.array([0.01, 0.0, 0.0]), inertia=np.diag(share * solid))
        assert add_box(file, tmp_path, name, mass).meta["inertia"][0][0] == pytest.approx(share * solid[0])


def test_the_same_content_is_not_computed_again(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DGRASP_CACHE", str(tmp_path / "cache"))
    cache = tmp_path / "cache" / "objects"
    first = add_box(file, tmp_path / "a")
    assert not first.cached and len(list(cache.iterdir())) == 1
    made = list(cache.rglob("*"))

    def never(*_: object) -> None:
        raise AssertionError("computed again")

    with monkeypatch.context() as patch:
        patch.setattr(add, "_make", never)
        copy = file.with_name("other.stl")
        copy.write_bytes(file.read_bytes())
        again = add_box(copy, tmp_path / "b", "other", Mass(1.0))
        assert again.cached and again.meta["mass_kg"] == 1.0 and again.meta["shapes"] == first.meta["shapes"]
        assert add_box(file, tmp_path / "a").meta == first.meta
        with pytest.raises(AssertionError, match="computed again"):
            add_object(file, tmp_path / "c", "box", "mm", None, "sphere")
    # A damaged entry is made again.
    next(path for path in made if path.name == "mesh.obj").write_text("v 0 0 0\n")
    assert not add_box(file, tmp_path / "d").cached


def test_a_cache_that_cannot_be_written_is_done_without(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "blocked").write_text("a file")
    monkeypatch.setenv("DGRASP_CACHE", str(tmp_path / "blocked"))
    assert not add_box(file, tmp_path / "a").cached and (tmp_path / "a" / "box" / META_FILE).is_file()


def test_nothing_is_overwritten_unasked(file: Path, tmp_path: Path) -> None:
    first = add_box(file, tmp_path)
    before = (first.folder / META_FILE).read_bytes()
    with pytest.raises(DataError, match="exists already and is another object; choose another --name, or --replace"):
        add_box(file, tmp_path, mass=Mass(0.5))
    assert (first.folder / META_FILE).read_bytes() == before
    replaced = add_box(file, tmp_path, mass=Mass(0.5), replace=True)
    assert load_object(replaced.folder, False).mass == 0.5 and replaced.meta["id"] != first.meta["id"]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("dear")
    with pytest.raises(DataError, match="exists already"):
        add_box(file, tmp_path, "mine", replace=True)
    assert (tmp_path / "mine" / "notes.txt").read_text() == "dear"
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_the_picture_shows_mesh_and_shapes(file: Path, tmp_path: Path) -> None:
    image = np.asarray(Image.open(add_box(file, tmp_path).folder / "picture.png").convert("RGB")).astype(int)
    assert image.shape == (640, 640, 3)
    left, right = image[20:, :320], image[20:, 320:]
    # The mesh is blue, shapes are brown.
    blue, brown = left[..., 2] > left[..., 0] + 30, right[..., 0] > right[..., 2] + 30
    assert 0.05 < blue.mean() < 0.8 and 0.05 < brown.mean() < 0.8


def test_files_that_were_changed_are_refused(file: Path, tmp_path: Path) -> None:
    folder = add_box(file, tmp_path).folder
    meta = json.loads((folder / META_FILE).read_text())
    for change, reason in (
        ({"schema": 9}, "not the description of an object"),
        ({"mass_kg": -1.0}, "out of range"),
        ({"shapes": []}, "out of range"),
        ({"shapes": [{**meta["shapes"][0], "size": [1.0]}]}, "out of range"),
        ({"shapes": [{**meta["shapes"][0], "kind": "hull", "size": [], "file": "../x.obj"}]}, "out of range"),
        ({"files": {"mesh.obj": "0" * 64}}, "its id no longer matches"),
        ({"mass_kg": 2.0 * meta["mass_kg"]}, "its id no longer matches"),
        ({"shapes": [{**meta["shapes"][0], "position": [0.0, 0.0, 0.1]}]}, "its id no longer matches"),
        ({"files": {"../mesh.obj": "0" * 64}}, "out of range"),
        ({"name": "other"}, "out of range"),
    ):
        (folder / META_FILE).write_text(json.dumps(meta | change))
        with pytest.raises(DataError, match=reason):
            load_object(folder, False)
    (folder / META_FILE).write_text(json.dumps(meta))
    (folder / "mesh.obj").write_text("v 0 0 0\n")
    with pytest.raises(DataError, match=r"mesh\.obj is missing or was changed"):
        load_object(folder, False)
    (folder / META_FILE).write_text("{")
    with pytest.raises(DataError, match="cannot be read"):
        load_object(folder, False)


def test_a_replacement_that_is_stopped_leaves_what_was_there(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = add_box(file, tmp_path / "objects").folder
    before, rename = (folder / META_FILE).read_bytes(), Path.rename

    def stopped(self: Path, to: Path) -> Path:
        if Path(to) == folder and not self.name.endswith(".old"):  # the new folder, to its place
            raise KeyboardInterrupt
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", stopped)
    with pytest.raises(KeyboardInterrupt):
        add_box(file, tmp_path / "objects", mass=Mass(kg=1.0), replace=True)
    assert (folder / META_FILE).read_bytes() == before and [p.name for p in folder.parent.iterdir()] == [folder.name]


def test_an_object_of_parts_brings_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def halves(solid: RepairedSolid, finer: bool) -> list[tuple[Array, Array]]:
        sides = (box((0.03, 0.05, 0.04), (x, 0.0, 0.0)) for x in (-0.015, 0.015))
        return [(np.asarray(side.vertices), np.asarray(side.faces)) for side in sides]

    monkeypatch.setattr("dgrasp.objects.add.fit.part_hulls", halves)
    added = add_object(save(box(), tmp_path / "a.glb"), tmp_path, "a", choice="parts")
    model = load_object(added.folder, False, parts=True)
    assert added.meta["figures"]["overlap"] == pytest.approx(1.0) and len(model.shapes) == 2
    for shape in model.shapes:
        assert shape.kind == "hull" and shape.file is not None and shape.file.parent == added.folder.absolute()
        assert trimesh.load(shape.file, force="mesh").volume == pytest.approx(VOLUME / 2)


def test_an_engine_that_takes_no_triangles_gets_parts(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    added = add_object(file, tmp_path, "a", "mm", choice="mesh")
    seen: list[Path] = []
    monkeypatch.setattr("dgrasp.objects.store.convex_parts", lambda path: seen.append(path) or ("parts",))
    assert load_object(added.folder, False).shapes[0].kind == "mesh" and not seen
    assert load_object(added.folder, False, parts=True).shapes == ("parts",)
    assert [path.parent for path in seen] == [added.folder.absolute()]


def test_where_objects_are_looked_for(file: Path, tmp_path: Path) -> None:
    added = add_box(file, tmp_path / "b", "cup")
    found = find_object("cup", [tmp_path / "a", tmp_path / "b"])
    assert found.folder == added.folder and found.id == added.meta["id"] and found.id.startswith("cup-")
    with pytest.raises(DataError, match=r"unknown object 'cub'.*there: cup\).*did you mean 'cup'.*dgrasp object add"):
        find_object("cub", [tmp_path / "a", tmp_path / "b"])
    assert default_store() == data_root() / "objects"


def test_a_thin_sheet_is_remarked_on(tmp_path: Path) -> None:
    sheet = add_object(save(box((0.2, 0.15, 0.0005)), tmp_path / "sheet.ply"), tmp_path, "sheet", choice="box")
    assert sheet.meta["figures"]["remarks"] == ["only 0.5 mm thick"] and sheet.meta["mass_kg"] == pytest.approx(0.0075)
