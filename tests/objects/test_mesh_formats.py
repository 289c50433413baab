"""What other programs write: separators, encodings, ways of counting, compression. Each file is a box or two."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.geometry.polygons import triangulated
from dgrasp.objects.add import mesh_reader
from dgrasp.objects.add.mesh_reader import read_mesh_file
from dgrasp.objects.add.repair import repair
from tests.objects.meshes import QUADS, SIZE, VOLUME, box, corners, save, solid_volume


def obj_lines(separator: str = " ", face: Callable[[int], str] = lambda i: str(i + 1)) -> str:
    lines = [separator.join(["v", *(f"{x:.9g}" for x in point)]) for point in corners()]
    return "\n".join([*lines, *(separator.join(["f", *map(face, quad)]) for quad in QUADS)]) + "\n"


def test_obj_indices_that_count_back_from_the_last_vertex_so_far(tmp_path: Path) -> None:
    text = ""
    for name, size, center in (("handle", (0.02, 0.02, 0.16), (0, 0, 0)), ("head", (0.1, 0.03, 0.03), (0, 0, 0.09))):
        text += f"o {name}\n" + "".join("v {:g} {:g} {:g}\n".format(*point) for point in corners(size, center))
        text += "".join("f " + " ".join(str(i - 8) for i in quad) + "\n" for quad in QUADS)
    (tmp_path / "hammer.obj").write_text(text)
    # 64 and 90 cm3 share 2 x 2 x 0.5 cm.
    assert solid_volume(tmp_path / "hammer.obj") == pytest.approx(152e-6)
    soup = ""
    for triangle in box().triangles:
        soup += "".join("v {:.9g} {:.9g} {:.9g}\n".format(*point) for point in triangle) + "f -3 -2 -1\n"
    (tmp_path / "soup.obj").write_text(soup)
    assert solid_volume(tmp_path / "soup.obj") == pytest.approx(VOLUME)


TEXTURED = "vt 0 0\nvn 0 0 1\n" + obj_lines(face=lambda i: f"{i + 1}/1/1")
OBJ_FORMS = {
    "tabs": obj_lines("\t").encode(),
    "spaces": obj_lines("   ").encode(),
    "windows": obj_lines().replace("\n", "\r\n").encode(),
    "old mac": obj_lines().replace("\n", "\r").encode(),
    "byte order mark": b"\xef\xbb\xbf" + obj_lines().encode(),
    "utf-16": obj_lines().encode("utf-16"),
    "latin-1": "# Größe\no Henkel für Tasse\n".encode("latin-1") + obj_lines().encode(),
    "shift-jis": "# 取っ手\n".encode("shift-jis") + obj_lines().encode(),
    "texture and normal": TEXTURED.encode(),
    "normal": ("vn 0 0 1\n" + obj_lines(face=lambda i: f"{i + 1}//1")).encode(),
    "negative texture": ("vt 0 0\nvn 0 0 1\n" + obj_lines(face=lambda i: f"{i - 8}/-1/-1")).encode(),
    "mixed": obj_lines().replace("f 1 2 4 3", "f 1/ 2/ 4/ 3/").replace("f 5 7 8 6", "f 5 7 8\nf 5 8 6").encode(),
    "continued": obj_lines().replace("f 1 2 4 3", "f 1 2 \\\n 4 3").replace("f 5 7", "f 5 7\\\r\n").encode(),
    "exponents and colours": obj_lines().replace("0.03 ", "3e-2 ").replace("0.02\nv", "0.02 0.5 0.5 0.5\nv").encode(),
    "comments": obj_lines().replace("f 1 2 4 3", "f 1 2 4 3 # side").replace("v -", "  v -").encode(),
    "groups, lines, points": (obj_lines() + "g x\ns off\nusemtl steel\nl 1 2\np 1\n").encode(),
}


@pytest.mark.parametrize("form", OBJ_FORMS)
def test_obj_forms(tmp_path: Path, form: str) -> None:
    (tmp_path / "a.obj").write_bytes(OBJ_FORMS[form])
    assert len(read_mesh_file(tmp_path / "a.obj").faces) == 12
    assert solid_volume(tmp_path / "a.obj") == pytest.approx(VOLUME)


def ply(order: str, mixed: bool, comment: bytes = b"", ending: bytes = b"\n") -> bytes:
    """The box as PLY: squares, or ("mixed") the first of them as two triangles; with a normal and a colour."""
    faces = [[0, 1, 3], [0, 3, 2], *QUADS[1:]] if mixed else QUADS
    name = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    head = [b"ply", comment, f"format {name} 1.0".encode(), b"element vertex 8"]
    head += [f"property float {axis}".encode() for axis in ("x", "y", "z", "nx")] + [b"property uchar red"]
    head += [f"element face {len(faces)}".encode(), b"property list uchar int vertex_indices", b"property int flags"]
    head += [b"element edge 1", b"property int vertex1", b"end_header"]
    text = ending.join(line for line in head if line) + ending
    if not order:
        rows = ["{:.9g} {:.9g} {:.9g} 0 255".format(*point) for point in corners()]
        rows += [" ".join(map(str, [len(face), *face, 7])) for face in faces]
        return text + ending.join(row.encode() for row in [*rows, "3"]) + ending
    for point in corners():
        text += struct.pack(f"{order}4fB", *point, 0.0, 255)
    for face in faces:
        text += struct.pack(f"{order}B{len(face)}ii", len(face), *face, 7)
    return text + struct.pack(f"{order}i", 3)


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("comment", [b"", "comment Henkel für 3 element vertex 9".encode("latin-1")])
@pytest.mark.parametrize("ending", [b"\n", b"\r\n"])
def test_ply_forms(tmp_path: Path, order: str, mixed: bool, comment: bytes, ending: bytes) -> None:
    (tmp_path / "a.ply").write_bytes(ply(order, mixed, comment, ending))
    assert len(read_mesh_file(tmp_path / "a.ply").faces) == 12
    assert solid_volume(tmp_path / "a.ply") == pytest.approx(VOLUME)
    (tmp_path / "a.ply").write_bytes(ply(order, mixed) + b"0 0 ")
    with pytest.raises(DataError, match="follow what its header announces"):
        read_mesh_file(tmp_path / "a.ply")


def test_ply_strips(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    strip = "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(head + strip + "0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 0 1 2\n")
    assert read_mesh_file(tmp_path / "a.ply").faces.tolist() == [[0, 1, 2], [3, 2, 1], [0, 1, 2]]


@pytest.mark.parametrize("change", [str, str.upper, lambda text: "\ufeff" + text.replace(" ", "\t")])
def test_stl_text_forms(tmp_path: Path, change: Callable[[str], str]) -> None:
    text = change("solid Größe\n" + trimesh.exchange.stl.export_stl_ascii(box()).split("\n", 1)[1])
    (tmp_path / "a.stl").write_text(text, encoding="utf-8")
    assert solid_volume(tmp_path / "a.stl") == pytest.approx(VOLUME, rel=1e-5)
    binary = bytearray(trimesh.exchange.stl.export_stl(box()))
    binary[:6] = b"solid "
    (tmp_path / "a.stl").write_bytes(bytes(binary))
    assert solid_volume(tmp_path / "a.stl") == pytest.approx(VOLUME, rel=1e-5)
    (tmp_path / "a.stl").write_bytes(bytes(binary[:-20]))
    with pytest.raises(DataError, match=r"announces 12 faces, but there are bytes for 11\.6"):
        read_mesh_file(tmp_path / "a.stl")


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("a.obj", obj_lines().replace(".", ","), "line 1 has a comma: 'v -0,03 -0,025 -0,02'"),
        ("a.obj", obj_lines().replace("v 0.03 ", "v 0.03, "), "line 5 has a comma"),
        ("a.ply", ply("", False).decode().replace("0.0", "0,0"), "line 15 has a comma: '-0,03 -0,025"),
        ("a.stl", trimesh.exchange.stl.export_stl_ascii(box()).replace(".", ","), "line 4 has a comma: 'vertex"),
    ],
)
def test_decimal_commas_are_named(tmp_path: Path, name: str, text: str, line: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(DataError, match=rf"{name}: {line}.*decimal point"):
        read_mesh_file(tmp_path / name)


def test_polygons_that_are_not_convex() -> None:
    # An L of three unit squares in the xz plane, seen from either side, and a pentagon with a notch.
    outline = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], dtype=float)
    vertices = np.stack([outline[:, 0], np.full(6, 5.0), outline[:, 1]], axis=1)
    for polygon in ([0, 1, 2, 3, 4, 5], [5, 4, 3, 2, 1, 0], [3, 4, 5, 0, 1, 2]):
        faces = triangulated(vertices, np.array(polygon), np.array([6]))
        a, b, c = np.moveaxis(vertices[faces], 1, 0)
        normals = np.cross(b - a, c - a) / 2
        # Each triangle turns the same way, so their areas add up to the L's.
        assert len(faces) == 4 and np.abs(normals[:, 1]).sum() == pytest.approx(3.0)
        around = np.cross(vertices[polygon], np.roll(vertices[polygon], -1, axis=0)).sum(axis=0)[1]
        assert (normals[:, 1] * around > 0).all()
    # A point, a line, a triangle and a square in one list.
    mixed = triangulated(vertices, np.array([0, 0, 1, 0, 1, 2, 0, 1, 3, 5]), np.array([1, 2, 3, 4]))
    assert mixed.tolist() == [[0, 1, 2], [0, 1, 3], [0, 3, 5]]


# Sizes


def test_a_normalised_mesh_has_no_unit(tmp_path: Path) -> None:
    # The longest side is 1 or 2 in a cube, and between them in a ball of radius 1.
    for side in (1.0, 2.0, 1.9995, 2.0 / 3.0**0.5, 1.7):
        read = read_mesh_file(save(box((side, 1.5 / 2 * side, 1.25 / 2 * side)), tmp_path / "a.obj"))
        with pytest.raises(DataError, match=r"normalised and has no unit; .*--units.*--scale"):
            read.scaled("auto")
    read = read_mesh_file(save(box((2.0, 1.5, 1.25)), tmp_path / "a.obj"))
    vertices, unit = read.scaled("auto", 0.1)
    assert unit == "m" and np.ptp(vertices, axis=0) == pytest.approx((0.2, 0.15, 0.125))
    assert np.ptp(read.scaled("cm")[0], axis=0) == pytest.approx((0.02, 0.015, 0.0125))
    assert np.ptp(read.scaled("mm", 100.0)[0], axis=0) == pytest.approx((0.2, 0.15, 0.125))
    assert read_mesh_file(save(box((2.01, 1.5, 1.25)), tmp_path / "a.obj")).scaled("auto")[1] == "cm"


def test_gltf_is_in_metres(tmp_path: Path) -> None:
    read = read_mesh_file(save(box((0.7, 0.5, 0.4)), tmp_path / "a.glb"))
    assert read.scaled("auto")[1] == "m"
    read = read_mesh_file(save(box((60.0, 50.0, 40.0)), tmp_path / "a.glb"))
    with pytest.raises(DataError, match=r"longest side is 60 m in m, the unit of glTF; .*--units"):
        read.scaled("auto")
    assert np.ptp(read.scaled("mm")[0], axis=0) == pytest.approx(SIZE)


def test_many_faces_are_decimated_with_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = trimesh.creation.icosphere(4, 0.05)
    monkeypatch.setattr(mesh_reader, "KEPT_FACES", 2000)
    read = read_mesh_file(save(ball, tmp_path / "a.stl"))
    assert len(ball.faces) == 5120 and 1900 < len(read.faces) <= 2000
    assert read.notes == (f"decimated from 5120 to {len(read.faces)} faces",)
    # 4/3 pi r^3 less what the triangles cut off.
    assert repair(read.vertices, read.faces).solid.volume() == pytest.approx(523.6e-6, rel=5e-3)
