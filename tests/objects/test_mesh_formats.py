"""What other programs write: separators, encodings, ways of counting, compression. Each file is a box or two."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.objects.add import mesh_reader
from dgrasp.objects.add.mesh_reader import read_mesh_file
from dgrasp.objects.add.polygons import triangulated
from dgrasp.objects.add.repair import repair
from dgrasp.types import Array
from tests.objects.meshes import SIZE, VOLUME, box, save

QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
"""The faces of `corners`, wound outwards."""


def corners(size: tuple[float, float, float] = SIZE, center: tuple[float, float, float] = (0, 0, 0)) -> Array:
    """(8, 3) of a box."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return signs * np.array(size) / 2 + np.array(center)


def solid_volume(path: Path) -> float:
    read = read_mesh_file(path)
    return float(repair(read.vertices, read.faces).solid.volume())


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


# GLB


def glb(content: dict, blob: bytes = b"") -> bytes:
    """A GLB file of a description and its buffer."""
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    if blob:
        body += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def described(points: Array, component: int = 5126, nodes: list[dict] | None = None) -> tuple[dict, bytes]:
    """A box of the corners `points` (8, n), n numbers a row as they lie in the buffer, the first three of them used."""
    faces = np.array([[quad[k] for k in pick] for quad in QUADS for pick in ((0, 1, 2), (0, 2, 3))], dtype="<u2")
    data, index = points.tobytes(), faces.tobytes()
    return {
        "asset": {"version": "2.0"}, "scene": 0, "nodes": nodes or [{"mesh": 0}], "scenes": [{"nodes": [0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [{"bufferView": 0, "componentType": component, "count": 8, "type": "VEC3"},
                      {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data), "byteStride": points.strides[0]},
                        {"buffer": 0, "byteOffset": len(data), "byteLength": len(index)}],
        "buffers": [{"byteLength": len(data) + len(index)}],
    }, data + index  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "component", "full", "signed"),
    [("<i1", 5120, 127, True), ("<u1", 5121, 255, False), ("<i2", 5122, 32767, True), ("<u2", 5123, 65535, False)],
)
def test_glb_of_normalised_integers(tmp_path: Path, kind: str, component: int, full: int, signed: bool) -> None:
    # From -1 to 1, or from 0 to 1, times the node's scale: a box of 60 x 50 x 40 mm.
    signs = corners((2.0, 2.0, 2.0)) if signed else corners((1.0, 1.0, 1.0), (0.5, 0.5, 0.5))
    points = np.zeros((8, 4), dtype=kind)
    points[:, :3] = np.rint(signs * full)
    scale = [side / (2.0 if signed else 1.0) for side in SIZE]
    content, blob = described(points, component, [{"mesh": 0, "scale": scale}])
    content["accessors"][0]["normalized"] = True
    content["extensionsUsed"] = content["extensionsRequired"] = ["KHR_mesh_quantization"]
    (tmp_path / "a.glb").write_bytes(glb(content, blob))
    read = read_mesh_file(tmp_path / "a.glb")
    assert np.ptp(read.vertices, axis=0) == pytest.approx(SIZE) and read.scaled("auto")[1] == "m"
    # Integers that are not normalised are themselves.
    del content["accessors"][0]["normalized"]
    content["nodes"][0]["scale"] = [side / full for side in scale]
    (tmp_path / "a.glb").write_bytes(glb(content, blob))
    assert np.ptp(read_mesh_file(tmp_path / "a.glb").vertices, axis=0) == pytest.approx(SIZE)


def test_glb_nodes_put_meshes_where_they_stand(tmp_path: Path) -> None:
    # A quarter turn about z, a mirror, a matrix in columns and a parent that moves them all.
    half = 0.5**0.5
    nodes = [
        {"children": [1, 2, 3], "translation": [0.0, 0.0, 1.0]},
        {"mesh": 0, "rotation": [0.0, 0.0, half, half], "translation": [0.1, 0.0, 0.0]},
        {"mesh": 0, "scale": [-1.0, 1.0, 1.0], "translation": [-0.1, 0.0, 0.0]},
        {"mesh": 0, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0.3, 0, 1]},
        {"mesh": 0},
    ]
    (tmp_path / "a.glb").write_bytes(glb(*described(corners().astype("<f4"), nodes=nodes)))
    read = read_mesh_file(tmp_path / "a.glb")
    assert read.vertices.shape == (24, 3) and read.vertices[:, 2].mean() == pytest.approx(1.0)
    assert np.ptp(read.vertices[:8], axis=0) == pytest.approx((SIZE[1], SIZE[0], SIZE[2]))
    assert read.vertices[16:].mean(axis=0) == pytest.approx((0.0, 0.3, 1.0))
    # 1 + 1 + 2^3 boxes, all wound outwards; the fifth node is not in the scene.
    assert trimesh.Trimesh(read.vertices, read.faces, process=False).volume == pytest.approx(10 * VOLUME, rel=1e-5)
    content, blob = described(corners().astype("<f4"), nodes=[{"children": [1]}, {"children": [0]}])
    (tmp_path / "a.glb").write_bytes(glb(content, blob))
    with pytest.raises(DataError, match="its node 0 has two parents"):
        read_mesh_file(tmp_path / "a.glb")


def test_glb_strips_fans_and_sparse_positions(tmp_path: Path) -> None:
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype="<f4")
    index, place = np.array([2], dtype="<u2"), np.array([(3, 3, 0)], dtype="<f4")
    for mode, faces in ((4, None), (5, [[0, 1, 2], [3, 2, 1]]), (6, [[0, 1, 2], [0, 2, 3]])):
        content = {
            "asset": {"version": "2.0"}, "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "sparse": {
                "count": 1, "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 2}}}],
            "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 2},
                            {"buffer": 0, "byteOffset": 52, "byteLength": 12}],
            "buffers": [{"byteLength": 64}],
        }  # fmt: skip
        blob = points.tobytes() + index.tobytes() + b"\0\0" + place.tobytes()
        (tmp_path / "a.glb").write_bytes(glb(content, blob))
        if faces is None:
            with pytest.raises(DataError, match="4 corners of triangles; expected a multiple of three"):
                read_mesh_file(tmp_path / "a.glb")
            continue
        read = read_mesh_file(tmp_path / "a.glb")
        assert read.faces.tolist() == faces and read.vertices[2].tolist() == [3.0, 3.0, 0.0]


def test_glb_that_cannot_be_read_says_what_it_needs(tmp_path: Path) -> None:
    def refused(change: Callable[[dict], object], reason: str) -> None:
        content, blob = described(corners().astype("<f4"))
        change(content)
        (tmp_path / "a.glb").write_bytes(glb(content, blob))
        with pytest.raises(DataError, match=rf"a\.glb: .*{reason}.*export it"):
            read_mesh_file(tmp_path / "a.glb")

    def draco(content: dict) -> None:
        content["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
        del content["accessors"][0]["bufferView"]

    refused(draco, "KHR_draco_mesh_compression")
    refused(lambda c: c.update(extensionsRequired=["KHR_draco_mesh_compression"]), "Draco compression")
    refused(lambda c: c.update(extensionsRequired=["EXT_meshopt_compression"]), "EXT_meshopt_compression")
    refused(lambda c: c["bufferViews"][0].update(extensions={"EXT_meshopt_compression": {}}), "EXT_meshopt_compression")
    refused(lambda c: c["buffers"][0].update(uri="outside.bin"), r"'outside\.bin' is outside of the file")
    content, blob = described(corners().astype("<f4"))
    content["extensionsRequired"] = ["KHR_materials_unlit", "KHR_texture_transform"]
    (tmp_path / "a.glb").write_bytes(glb(content, blob))
    assert solid_volume(tmp_path / "a.glb") == pytest.approx(VOLUME, rel=1e-5)


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
    for side in (1.0, 2.0, 1.9995):
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
