"""Mesh files: four formats, units, and everything that is not a mesh."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.objects.add import mesh_reader
from dgrasp.objects.add.mesh_reader import read_mesh_file
from tests.objects.meshes import SIZE, VOLUME, box, joined, plain, save


def volume(path: Path) -> float:
    read = read_mesh_file(path)
    return float(trimesh.Trimesh(read.vertices, read.faces).volume)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb"])
def test_every_format_gives_the_same_solid(tmp_path: Path, suffix: str) -> None:
    path = save(box(center=(0.1, 0.0, 0.0)), tmp_path / f"box.{suffix}")
    read = read_mesh_file(path)
    assert read.faces.shape == (12, 3) and np.ptp(read.vertices, axis=0) == pytest.approx(SIZE)
    assert read.vertices[:, 0].max() == pytest.approx(0.13) and volume(path) == pytest.approx(VOLUME, rel=1e-5)
    assert read.scaled("auto")[1] == "m" and len(read.sha256) == 64


def test_text_forms_and_capital_suffixes(tmp_path: Path) -> None:
    (tmp_path / "box.STL").write_bytes(trimesh.exchange.stl.export_stl_ascii(box()).encode())
    (tmp_path / "box.ply").write_bytes(trimesh.exchange.ply.export_ply(box(), encoding="ascii"))
    # A square of one polygon, and indices that count from the end.
    (tmp_path / "square.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n")
    for name in ("box.STL", "box.ply"):
        assert volume(tmp_path / name) == pytest.approx(VOLUME, rel=1e-5)
    assert read_mesh_file(tmp_path / "square.obj").faces.shape == (2, 3)


def test_a_glb_scene_is_read_as_it_stands(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(box(), node_name="a", geom_name="box")
    scene.graph.update("b", matrix=trimesh.transformations.translation_matrix((0.2, 0, 0)), geometry="box")
    (tmp_path / "two.glb").write_bytes(scene.export(file_type="glb"))
    read = read_mesh_file(tmp_path / "two.glb")
    assert len(read.faces) == 24 and np.ptp(read.vertices, axis=0) == pytest.approx((0.26, 0.05, 0.04))


def test_a_scene_that_shows_a_mesh_too_often(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(box(), node_name="a", geom_name="box")
    for i in range(9):
        scene.graph.update(f"n{i}", matrix=np.eye(4), geometry="box")
    (tmp_path / "ten.glb").write_bytes(scene.export(file_type="glb"))
    monkeypatch.setattr(mesh_reader, "MAX_FACES", 100)
    with pytest.raises(DataError, match=r"ten\.glb: 108 faces and more; at most 100"):
        read_mesh_file(tmp_path / "ten.glb")


@pytest.mark.parametrize(
    ("longest", "unit", "meters"), [(0.115, "m", 0.115), (60.0, "mm", 0.06), (3.0, "cm", 0.03), (0.01, "m", 0.01)]
)
def test_units_that_leave_no_doubt(tmp_path: Path, longest: float, unit: str, meters: float) -> None:
    read = read_mesh_file(save(box((longest, longest / 2, longest / 2)), tmp_path / "a.obj"))
    vertices, found = read.scaled("auto")
    assert found == unit and np.ptp(vertices, axis=0).max() == pytest.approx(meters)


def test_units_in_doubt_are_asked_for(tmp_path: Path) -> None:
    read = read_mesh_file(save(box((18.0, 9.0, 9.0)), tmp_path / "a.obj"))
    with pytest.raises(DataError, match=r"longest side is 18: 0\.18 m if in cm or 0\.018 m if in mm; .*--units"):
        read.scaled("auto")
    assert np.ptp(read.scaled("cm")[0], axis=0) == pytest.approx((0.18, 0.09, 0.09))
    with pytest.raises(DataError, match=r"the longest side is 18 m in m; expected 0\.5 cm to 100 cm"):
        read.scaled("m")
    # 0.7 may be a long object in m, or one of 7 mm in cm; neither is a better guess.
    for size in (5000.0, 0.7, 0.001):
        with pytest.raises(DataError, match=r"no usual object .*expected 1 cm to 50 cm; state --units"):
            read_mesh_file(save(box((size, size, size)), tmp_path / "b.obj")).scaled("auto")


def test_a_vertex_that_no_face_uses_has_no_size(tmp_path: Path) -> None:
    path = save(box(), tmp_path / "a.obj")
    path.write_text(path.read_text() + "v 900 0 0\n")
    assert read_mesh_file(path).scaled("auto")[1] == "m"


def glb(content: dict) -> bytes:
    """A GLB file with only a JSON chunk."""
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + struct.pack("<III", 2, 20 + len(text), len(text)) + b"JSON" + text


HUGE = {"accessors": [{"count": 4_000_000_000, "componentType": 5126, "type": "VEC3"}]}
PLY = b"ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nelement face 4\nend_header\n"


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.obj", b"", "the file is empty"),
        ("a.stl", b" \n", "the file is empty"),
        ("a.obj", b"# nothing here\n", "no faces|cannot be read"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read|names vertex"),
        ("a.obj", b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "1 of 3 vertices are NaN"),
        ("a.obj", b"v 0 0 0\nv 1 0 inf\nv 0 1 0\nf 1 2 3\n", "NaN or infinite"),
        ("a.obj", b"v 0 0 0\nv 1 0 x\nf 1 1 1\n", "line 2 is 'v 1 0 x'; expected v and three numbers"),
        ("a.obj", b"\x00\xff\xfe" * 50, "cannot be read|no faces"),
        ("a.stl", b"\0" * 50, "less than the header"),
        ("a.stl", b"\0" * 80 + struct.pack("<I", 2**32 - 1) + b"\0" * 50, "announces 4294967295 faces"),
        ("a.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0", "cannot be read|no faces"),
        ("a.stl", b"solid x\nfacet normal 0 0 q\nouter loop\nvertex 0 0 0\nendloop", "cannot be read|no faces"),
        ("a.ply", PLY % 3_000_000_000, "announces 3000000004 rows"),
        ("a.ply", b"ply\nformat ascii 1.0\n", "cannot be read|no faces"),
        ("a.ply", b"no ply", "cannot be read"),
        ("a.glb", b"glTF", "does not begin like"),
        ("a.glb", b"glTF" + struct.pack("<III", 2, 99999, 40) + b"JSON{}", "announces 99999 bytes"),
        ("a.glb", glb(HUGE), "announces 4000000000 rows"),
        ("a.glb", glb({"accessors": [{"count": -1}]}), "an accessor counts '-1'"),
        ("a.glb", glb({"asset": {"version": "2.0"}}), "no faces|cannot be read"),
        ("a.glb", glb({"meshes": [{"primitives": [{}]}]}), "no faces|cannot be read"),
        ("a.step", b"ISO-10303-21;", "a file of type 'step'; expected one of obj, stl, ply, glb"),
        ("a", b"x", "a file of type '"),
    ],
)
def test_bad_files_are_one_message(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str, content: bytes, reason: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=reason) as error:
        read_mesh_file(tmp_path / name)
    assert str(error.value).startswith(str(tmp_path / name)) and "\n" not in str(error.value)
    assert not caplog.records


@pytest.mark.parametrize("suffix", ["stl", "ply", "glb"])
def test_every_cut_of_a_file_is_refused(tmp_path: Path, suffix: str) -> None:
    whole = save(box(), tmp_path / f"box.{suffix}").read_bytes()
    for share in (0.02, 0.3, 0.9, 0.99):
        (tmp_path / f"cut.{suffix}").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(DataError, match="cut"):
            read_mesh_file(tmp_path / f"cut.{suffix}")


def test_a_folder_a_missing_file_and_one_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "folder.obj").mkdir()
    for path, reason in ((tmp_path / "folder.obj", "cannot be read"), (tmp_path / "none.obj", "no such mesh file")):
        with pytest.raises(DataError, match=reason):
            read_mesh_file(path)
    path = save(joined(box(), box()), tmp_path / "a.obj")
    monkeypatch.setattr(mesh_reader, "MAX_FACES", 20)
    with pytest.raises(DataError, match="24 faces; at most 20 are allowed"):
        read_mesh_file(path)
    monkeypatch.setattr(mesh_reader, "MAX_BYTES", 100)
    with pytest.raises(DataError, match="bytes; at most 100 are allowed"):
        read_mesh_file(path)


def test_nothing_outside_of_the_file_is_read(tmp_path: Path) -> None:
    text = save(box(), tmp_path / "a.obj").read_text()
    (tmp_path / "a.obj").write_text(f"mtllib {tmp_path / 'missing.mtl'}\nusemtl x\n{text}")
    assert len(read_mesh_file(tmp_path / "a.obj").faces) == 12
    content = {"asset": {"version": "2.0"}, "buffers": [{"uri": "other.bin", "byteLength": 36}],
               "bufferViews": [{"buffer": 0, "byteLength": 36}],
               "accessors": [{"bufferView": 0, "count": 3, "componentType": 5126, "type": "VEC3"}],
               "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "nodes": [{"mesh": 0}]}  # fmt: skip
    (tmp_path / "other.bin").write_bytes(plain(box().vertices, box().faces).vertices.astype("<f4").tobytes()[:36])
    (tmp_path / "a.glb").write_bytes(glb(content))
    with pytest.raises(DataError, match=r"a\.glb"):
        read_mesh_file(tmp_path / "a.glb")
