"""GLB: integers, nodes, strips, buffers, and what cannot be read. Each file is a box or two."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.objects.add.mesh_reader import read_mesh_file
from dgrasp.types import Array
from tests.objects.meshes import QUADS, SIZE, VOLUME, corners, solid_volume


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
    refused(lambda c: c["nodes"][0].update(skin=0), r"mesh 0 .*bones \(a skin\)")
    refused(lambda c: c["meshes"][0].update(weights=[0.0, 0.5]), "mesh 0 .*morph targets")
    refused(lambda c: c["nodes"][0].update(weights=[1.0]), "mesh 0 .*morph targets")
    refused(lambda c: c["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {}}), "EXT_mesh_gpu_instancing")
    content, blob = described(corners().astype("<f4"))
    content["extensionsRequired"] = ["KHR_materials_unlit", "KHR_texture_transform"]
    content["meshes"][0]["weights"] = [0.0]
    (tmp_path / "a.glb").write_bytes(glb(content, blob))
    assert solid_volume(tmp_path / "a.glb") == pytest.approx(VOLUME, rel=1e-5)


def test_glb_buffers_as_data_uris(tmp_path: Path) -> None:
    # The points in the file's own buffer, the faces in one of base64.
    content, blob = described(corners().astype("<f4"))
    first = content["bufferViews"][0]["byteLength"]
    content["bufferViews"][1] |= {"buffer": 1, "byteOffset": 0}
    text = base64.b64encode(blob[first:]).decode()
    uri = f"data:application/gltf-buffer;base64,{text}"
    content["buffers"] = [{"byteLength": first}, {"byteLength": 72, "uri": uri}]
    (tmp_path / "a.glb").write_bytes(glb(content, blob[:first]))
    assert solid_volume(tmp_path / "a.glb") == pytest.approx(VOLUME, rel=1e-5)
    del content["buffers"][1]["uri"]
    (tmp_path / "a.glb").write_bytes(glb(content, blob[:first]))
    with pytest.raises(DataError, match="reads beyond the 0 bytes"):
        read_mesh_file(tmp_path / "a.glb")
