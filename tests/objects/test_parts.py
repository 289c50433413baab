"""Convex parts: what is kept in the cache, and what happens if the cache or the mesh is unusable."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest
import trimesh

from dgrasp.config.experiment import load_config
from dgrasp.errors import ConfigError, DataError
from dgrasp.files.paths import user_cache_root
from dgrasp.geometry.inertia import load_mesh, mesh_properties
from dgrasp.geometry.inside import inside_shape, union_volume
from dgrasp.objects.add import parts
from dgrasp.objects.add.parts import convex_parts, reduced_hull
from dgrasp.objects.add.repair import RepairedSolid
from dgrasp.objects.release import release_object
from dgrasp.types import Array

EDGE = 0.04
L_VOLUME = 3 * EDGE**3
Hulls = list[tuple[Array, Array]]
CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


def write_l_shape(path: Path, edge: float = EDGE) -> Path:
    """Three cubes of edge `edge` as an L in the xy plane, its notch towards +x +y."""
    outline = edge * np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], dtype=float)
    vertices = np.concatenate([np.c_[outline, np.zeros(6)], np.c_[outline, np.full(6, edge)]])
    fan = [(3, 4, 5), (3, 5, 0), (3, 0, 1), (3, 1, 2)]
    faces = [(c, b, a) for a, b, c in fan] + [(a + 6, b + 6, c + 6) for a, b, c in fan]
    for i in range(6):
        j = (i + 1) % 6
        faces += [(i, j, j + 6), (i, j + 6, i + 6)]
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache for one test."""
    monkeypatch.setenv("DGRASP_CACHE", str(tmp_path / "cache"))
    parts._temporary_root.cache_clear()
    return tmp_path / "cache"


def hulls_of(*corners: Array) -> Hulls:
    made = [reduced_hull(points, 64, 1e-6) for points in corners]
    return [hull for hull in made if hull is not None]


@pytest.fixture
def cuts(monkeypatch: pytest.MonkeyPatch) -> list[RepairedSolid]:
    """In place of the cutter: the L's two bars. Returns the solid of each decomposition."""
    calls: list[RepairedSolid] = []

    def run(solid: RepairedSolid) -> Hulls:
        calls.append(solid)
        return hulls_of(CUBE * (2 * EDGE, EDGE, EDGE), CUBE * EDGE + (0.0, EDGE, 0.0))

    monkeypatch.setattr(parts, "part_hulls", run)
    return calls


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    return write_l_shape(tmp_path / "objects" / "bracket" / "mesh.obj")


def test_an_l_shape_is_cut_into_its_two_bars(mesh: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert mesh_properties(mesh).volume == pytest.approx(L_VOLUME)
    shapes = convex_parts(mesh)
    assert len(shapes) == 2 and {shape.kind for shape in shapes} == {"hull"}
    assert union_volume(shapes) == pytest.approx(L_VOLUME, rel=0.02)
    for shape in shapes:
        assert shape.file is not None and shape.file.is_absolute()
        part = load_mesh(shape.file)
        # Closed, wound outwards, and no smaller than its hull.
        assert part.is_volume and part.volume == pytest.approx(part.convex_hull.volume)
    notch = np.array([[1.2 * EDGE, 1.2 * EDGE, EDGE / 2], [1.8 * EDGE, 1.8 * EDGE, EDGE / 2]])
    assert not any(inside_shape(shape, notch).any() for shape in shapes)
    said = capsys.readouterr()
    assert said.out == ""
    first, second = said.err.splitlines()
    assert first.startswith("bracket: cutting mesh.obj into convex parts, once")
    assert second.startswith("bracket: 2 parts in ") and second.endswith(", 100.0% of the surface within 2 mm")


def test_a_mesh_gives_the_same_parts_again(mesh: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    once = [shape.file for shape in convex_parts(mesh)]
    monkeypatch.setenv("DGRASP_CACHE", str(tmp_path / "other"))
    again = [shape.file for shape in convex_parts(mesh)]
    assert [f.name for f in once if f] == [f.name for f in again if f]
    assert once[0] != again[0]


def test_the_second_call_takes_the_first_ones_parts(
    mesh: Path, cuts: list[RepairedSolid], capsys: pytest.CaptureFixture[str]
) -> None:
    first = convex_parts(mesh)
    assert capsys.readouterr().err != ""
    assert convex_parts(mesh) == first
    assert len(cuts) == 1 and capsys.readouterr().err == ""


def test_what_names_an_entry(
    mesh: Path, tmp_path: Path, cuts: list[RepairedSolid], monkeypatch: pytest.MonkeyPatch
) -> None:
    def folder(path: Path) -> Path:
        file = convex_parts(path)[0].file
        assert file is not None
        return file.parent

    first = folder(mesh)
    assert folder(write_l_shape(tmp_path / "elsewhere" / "bracket" / "m.obj")) == first
    assert len(cuts) == 1
    others = [folder(write_l_shape(mesh, 1.001 * EDGE))]
    monkeypatch.setattr(parts, "_FORMAT", 0)
    others += [folder(mesh)]
    monkeypatch.setattr(parts, "version", lambda name: "0")
    others += [folder(mesh)]
    assert len({first, *others}) == 4 and len(cuts) == 4


def entry(cache: Path) -> Path:
    (folder,) = (cache / "parts").iterdir()
    return folder


def part_file(cache: Path) -> Path:
    return sorted(entry(cache).glob("*.obj"))[0]


DAMAGES: dict[str, Callable[[Path], object]] = {
    "part gone": lambda cache: part_file(cache).unlink(),
    "part cut short": lambda cache: part_file(cache).write_bytes(part_file(cache).read_bytes()[:-9]),
    "part changed": lambda cache: part_file(cache).write_text(part_file(cache).read_text().replace("0", "1", 1)),
    "manifest gone": lambda cache: (entry(cache) / "parts.json").unlink(),
    "manifest cut short": lambda cache: (entry(cache) / "parts.json").write_text('{"parts": ["00-'),
    "manifest no text": lambda cache: (entry(cache) / "parts.json").write_bytes(b"\xff\xfe\x00"),
    "manifest empty": lambda cache: (entry(cache) / "parts.json").write_text('{"parts": []}'),
    "manifest a list": lambda cache: (entry(cache) / "parts.json").write_text("[1, 2]"),
    "manifest of numbers": lambda cache: (entry(cache) / "parts.json").write_text('{"parts": [1, 2]}'),
    "manifest null": lambda cache: (entry(cache) / "parts.json").write_text('{"parts": null}'),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_entry_is_made_anew(damage: str, mesh: Path, cache: Path, cuts: list[RepairedSolid]) -> None:
    first = convex_parts(mesh)
    texts = [shape.file.read_text() for shape in first if shape.file]
    DAMAGES[damage](cache)
    assert convex_parts(mesh) == first and len(cuts) == 2
    assert [shape.file.read_text() for shape in first if shape.file] == texts
    assert convex_parts(mesh) == first and len(cuts) == 2


def test_those_who_make_the_same_entry_at_once_get_whole_ones(
    mesh: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    together = Barrier(4)

    def run(solid: RepairedSolid) -> Hulls:
        # Each finds different parts, as if each had another version of the library.
        size = 1.0 + 0.1 * together.wait(timeout=20)
        return hulls_of(CUBE * size, CUBE * size + 2.0)

    monkeypatch.setattr(parts, "part_hulls", run)
    with ThreadPoolExecutor(4) as pool:
        made = list(pool.map(convex_parts, [mesh] * 4))
    sizes = []
    for shapes in made:
        first, second = (load_mesh(shape.file).extents for shape in shapes if shape.file)
        assert first == pytest.approx(second)
        sizes.append(round(float(first[0]), 3))
    assert sorted(sizes) == [1.0, 1.1, 1.2, 1.3]
    assert convex_parts(mesh) in made
    assert [p.name for p in entry(cache).iterdir() if p.name.startswith(".")] == []


def test_a_cache_that_cannot_be_written_is_said_and_done_without(
    mesh: Path, cache: Path, cuts: list[RepairedSolid], capsys: pytest.CaptureFixture[str]
) -> None:
    cache.write_text("a file where the folder should be")
    shapes = convex_parts(mesh)
    assert all(shape.file is not None and shape.file.is_file() for shape in shapes)
    *_, last = capsys.readouterr().err.splitlines()
    assert str(cache) in last and "cannot be written" in last and "temporary folder" in last and "DGRASP_CACHE" in last
    assert convex_parts(mesh) == shapes and len(cuts) == 1
    assert cache.read_text() == "a file where the folder should be"


def test_bad_meshes_are_named(tmp_path: Path, cuts: list[RepairedSolid]) -> None:
    absent = tmp_path / "absent.obj"
    with pytest.raises(DataError, match=r"absent\.obj: this mesh does not exist"):
        convex_parts(absent)
    with pytest.raises(DataError, match="cannot be read"):
        convex_parts(tmp_path)
    empty = tmp_path / "empty.obj"
    empty.write_text("")
    with pytest.raises(DataError, match=r"empty\.obj"):
        convex_parts(empty)
    flat = tmp_path / "flat.obj"
    flat.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n")
    with pytest.raises(DataError, match=r"flat\.obj: fewer than four faces that have an area"):
        convex_parts(flat)
    assert cuts == []


def test_no_parts_at_all_is_an_error(mesh: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "part_hulls", lambda solid: [])
    with pytest.raises(DataError, match=r"mesh\.obj: no convex parts were found"):
        convex_parts(mesh)
    assert not cache.exists()


def test_a_hull_keeps_its_corners_alone() -> None:
    lattice = np.array([[x, y, z] for x in (0.0, 0.5, 1.0) for y in (0.0, 0.5, 1.0) for z in (0.0, 0.5, 1.0)])
    hull = reduced_hull(lattice, 64, 5e-4)
    assert hull is not None
    vertices, faces = hull
    assert sorted(map(tuple, vertices)) == sorted(map(tuple, CUBE)) and len(faces) == 12
    assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(1.0)


@pytest.mark.parametrize(("limit", "best"), [(4, 8 / 3**2.5), (6, 4 / 3), (8, 8 / 3**1.5)])
def test_few_vertices_are_spread_well(limit: int, best: float) -> None:
    directions = np.random.default_rng(0).normal(size=(500, 3))
    ball = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    hull = reduced_hull(ball, limit, 5e-4)
    assert hull is not None
    mesh = trimesh.Trimesh(*hull, process=False)
    assert len(hull[0]) == limit and mesh.is_volume
    # The regular tetrahedron, octahedron and cube in the unit ball.
    assert 0.6 * best < mesh.volume < 1.1 * best


def test_slivers_are_no_hulls() -> None:
    assert reduced_hull(CUBE * (1.0, 1.0, 0.0), 64, 5e-4) is None
    assert reduced_hull(CUBE[:3], 64, 5e-4) is None
    assert reduced_hull(np.zeros((8, 3)), 64, 5e-4) is None


@pytest.mark.parametrize("compat", [True, False])
def test_mass_and_inertia_are_the_meshs(tmp_path: Path, cuts: list[RepairedSolid], compat: bool) -> None:
    write_l_shape(tmp_path / "025_mug" / "textured_meshlab_quart.obj")
    whole = release_object(tmp_path, "025_mug", "ycb", compat, "mesh")
    cut = release_object(tmp_path, "025_mug", "ycb", compat, "parts")
    assert [shape.kind for shape in whole.shapes] == ["mesh"] and [shape.kind for shape in cut.shapes] == ["hull"] * 2
    assert cut.mass == whole.mass == 0.118
    assert np.array_equal(cut.center_of_mass_O, whole.center_of_mass_O) and np.array_equal(cut.inertia, whole.inertia)
    assert np.array_equal(cut.inertia, np.eye(3)) == compat


def test_thin_objects_keep_their_triangles_where_there_is_a_choice(tmp_path: Path, cuts: list[RepairedSolid]) -> None:
    for name, kinds in (("035_power_drill", ["hull"] * 2), ("024_bowl", ["mesh"])):
        write_l_shape(tmp_path / name / "textured_meshlab_quart.obj")
        assert [shape.kind for shape in release_object(tmp_path, name, "ycb", True).shapes] == kinds
    assert [shape.kind for shape in release_object(tmp_path, "024_bowl", "ycb", True, "parts").shapes] == ["hull"] * 2


def test_other_kinds_of_shape_are_left_alone(tmp_path: Path, cuts: list[RepairedSolid]) -> None:
    write_l_shape(tmp_path / "036_wood_block" / "mesh_aligned.obj")
    (block,) = release_object(tmp_path, "036_wood_block", "ycb", True, "parts").shapes
    (box,) = release_object(tmp_path, "004_sugar_box", "ycb", True, "parts").shapes
    assert (block.kind, box.kind) == ("hull", "box") and cuts == []


def test_triangles_are_for_pybullet_alone() -> None:
    with pytest.raises(ConfigError, match=r"physics\.concave: mujoco does not support concave meshes"):
        load_config(None, ["engine=mujoco", "physics.concave=mesh"])
    assert load_config(None, ["engine=mujoco"]).physics.concave == "auto"


def test_where_the_cache_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cache: Path) -> None:
    assert user_cache_root() == cache
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    for name in ("DGRASP_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    found = {}
    for platform in ("linux", "darwin", "win32"):
        monkeypatch.setattr(sys, "platform", platform)
        found[platform] = user_cache_root().relative_to(tmp_path).as_posix()
    assert found == {
        "linux": ".cache/dgrasp", "darwin": "Library/Caches/dgrasp", "win32": "AppData/Local/dgrasp/Cache"
    }  # fmt: skip
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert user_cache_root() == tmp_path / ".cache" / "dgrasp"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert user_cache_root() == tmp_path / "xdg" / "dgrasp"


def test_the_manifest_is_json(mesh: Path, cache: Path, cuts: list[RepairedSolid]) -> None:
    convex_parts(mesh)
    names = json.loads((entry(cache) / "parts.json").read_text())["parts"]
    assert [f"{name}.obj" for name in names] == sorted(p.name for p in entry(cache).glob("*.obj"))
