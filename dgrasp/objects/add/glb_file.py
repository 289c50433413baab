"""GLB (binary glTF 2.0): the triangles of its scene, in metres, where the nodes put them."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3}
_DIVISORS = {5120: 127.0, 5121: 255.0, 5122: 32767.0, 5123: 65535.0}
"""What normalised integers are divided by (glTF 2.0, section 3.6.2.2)."""
_READ = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_xmp")
"""Beginnings of the names of extensions that are read, or that change no shape."""
_INSTANCES = "EXT_mesh_gpu_instancing"
_DRACO = "KHR_draco_mesh_compression"


def read_glb(raw: bytes, most_faces: int, most_rows: int) -> tuple[Array, Array]:
    """Vertices (V, 3) m and triangles (F, 3) of the file's default scene; without scenes, of all its nodes.

    most_faces: faces of the whole scene, which may show one mesh many times. most_rows: rows that the accessors may
    announce. Raises `DataError` for a damaged file, for a buffer in a file of its own, and for compression, skins,
    morph targets and other extensions without which the shape cannot be known.
    """
    content, chunk = _chunks(raw)
    rows = sum(_count(accessor) for accessor in content.get("accessors", []))
    if rows > most_rows:
        raise DataError(f"its header announces {rows} rows; at most {most_rows} are taken; decimate the mesh first")
    _check_extensions(content)
    blobs = [_buffer(buffer, b"" if index else chunk) for index, buffer in enumerate(content.get("buffers", []))]
    meshes: dict[int, list[tuple[Array, Array]]] = {}
    vertices: list[Array] = [np.zeros((0, 3))]
    faces: list[Array] = [np.zeros((0, 3), dtype=np.int64)]
    seen, shown = 0, 0
    for index, T in _shown(content):
        if index not in meshes:
            meshes[index] = [_primitive(content, blobs, p) for p in content["meshes"][index]["primitives"]
                             if p.get("mode", 4) >= 4]
        for points, triangles in meshes[index]:
            shown += len(triangles)
            if shown > most_faces:
                raise DataError(f"{shown} faces and more; at most {most_faces} are taken; decimate the mesh first")
            vertices.append(points @ T[:3, :3].T + T[:3, 3])
            # A mirror turns the winding over.
            faces.append((triangles if np.linalg.det(T[:3, :3]) >= 0.0 else triangles[:, ::-1]) + seen)
            seen += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


def _chunks(raw: bytes) -> tuple[dict[str, Any], bytes]:
    """The description and the binary chunk, which may be empty."""
    if raw[:4] != b"glTF" or len(raw) < 20:
        raise DataError("it does not begin like a GLB file; expected glTF 2.0 in its binary form")
    version, length, size = struct.unpack_from("<III", raw, 4)
    if version != 2:
        raise DataError(f"it is glTF {version}; expected glTF 2.0; export it again")
    if length != len(raw) or 20 + size > length:
        raise DataError(f"its header announces {length} bytes, but there are {len(raw)}; the file is damaged or cut "
                        "off")
    content = json.loads(raw[20 : 20 + size])
    if not isinstance(content, dict):
        raise DataError("its description is no JSON object; the file is damaged")
    at, blob = 20 + size, b""
    while at + 8 <= length:
        size, kind = struct.unpack_from("<I4s", raw, at)
        if at + 8 + size > length:
            raise DataError("a chunk is longer than the file; the file is damaged or cut off")
        if kind == b"BIN\0":
            blob = raw[at + 8 : at + 8 + size]
        at += 8 + size
    return content, blob


def _buffer(buffer: dict[str, Any], chunk: bytes) -> bytes:
    """The bytes of a buffer: those of a `data:` URI, or without a URI the file's binary chunk (of the first buffer)."""
    uri = buffer.get("uri")
    if uri is None:
        return chunk
    head, comma, text = str(uri).partition(",")
    if head.startswith("data:") and head.endswith(";base64") and comma:
        return base64.b64decode(text, validate=True)
    raise DataError(f"its buffer {str(uri)[:60]!r} is outside of the file; expected a GLB that holds its own buffer; "
                    "export it as one file (glTF binary, .glb)")


def _count(accessor: Any) -> int:
    count = accessor.get("count") if isinstance(accessor, dict) else None
    if isinstance(count, bool) or not isinstance(count, int) or count < 0:
        raise DataError(f"an accessor counts {str(count)[:50]!r}; expected a number of rows; the file is damaged")
    return count


def _check_extensions(content: dict[str, Any]) -> None:
    """Refuse what is needed to know the shape and is not read; the message names it."""
    for name in content.get("extensionsRequired", []):
        if not str(name).startswith(_READ):
            what = "Draco compression" if name == _DRACO else "the extension"
            raise DataError(f"it needs {what} ({str(name)[:60]}), which is not read; export it without compression and "
                            "extensions")


def _shown(content: dict[str, Any]) -> Iterator[tuple[int, Array]]:
    """The meshes of the scene with the transform (4, 4) that puts each there."""
    nodes = content.get("nodes", [])
    scenes = content.get("scenes", [])
    if scenes:
        roots = scenes[content.get("scene", 0)].get("nodes", [])
    else:
        roots = sorted(set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])})
    open_nodes, seen = [(root, np.eye(4)) for root in reversed(roots)], set()
    while open_nodes:
        index, above = open_nodes.pop()
        if index in seen:
            raise DataError(f"its node {index} has two parents; the file is damaged")
        seen.add(index)
        T = above @ _placed(nodes[index])
        if "mesh" in nodes[index]:
            _check_rigid(content, nodes[index])
            yield nodes[index]["mesh"], T
        open_nodes += [(child, T) for child in reversed(nodes[index].get("children", []))]


def _check_rigid(content: dict[str, Any], node: dict[str, Any]) -> None:
    """Refuse a node whose mesh bones or morph targets deform, or that shows it many times."""
    weights = node.get("weights", content["meshes"][node["mesh"]].get("weights", []))
    why = ("bones (a skin) deform it" if "skin" in node else "morph targets deform it" if any(weights) else
           f"{_INSTANCES} shows it many times" if _INSTANCES in node.get("extensions", {}) else None)
    if why is not None:
        raise DataError(f"its mesh {node['mesh']} does not stand as it is: {why}; expected plain meshes; apply this in "
                        "the modelling program, and export it again")


def _placed(node: dict[str, Any]) -> Array:
    """(4, 4) from a node to its parent: its matrix, or translation, rotation and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    T = np.eye(4)
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    T[:3, :3] = matrix_from_quaternion(np.array([w, x, y, z], dtype=float)) * np.array(node.get("scale", (1.0,) * 3))
    T[:3, 3] = node.get("translation", (0.0,) * 3)
    return T


def _primitive(content: dict[str, Any], blobs: list[bytes], primitive: dict[str, Any]) -> tuple[Array, Array]:
    """Vertices (V, 3) and triangles (F, 3) of a primitive of triangles, of a strip or of a fan."""
    position = content["accessors"][primitive["attributes"]["POSITION"]]
    if "bufferView" not in position and "sparse" not in position:
        names = ", ".join(primitive.get("extensions", {})) or "no extension"
        raise DataError(f"a mesh has no positions of its own ({names[:80]}); expected them in the file's buffer; "
                        "export it without compression")
    points = _values(content, blobs, position).astype(float)
    if "indices" in primitive:
        corners = _values(content, blobs, content["accessors"][primitive["indices"]]).reshape(-1).astype(np.int64)
    else:
        corners = np.arange(len(points))
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        raise DataError(f"a face names vertex {int(corners.max())} of {len(points)}; export it again")
    mode = primitive.get("mode", 4)
    if mode == 4:
        if len(corners) % 3:
            raise DataError(f"a mesh has {len(corners)} corners of triangles; expected a multiple of three; export it "
                            "again")
        return points, corners.reshape(-1, 3)
    if mode == 5:
        faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        faces[1::2] = faces[1::2, ::-1]
        return points, faces
    return points, np.stack([np.full(max(len(corners) - 2, 0), corners[0]), corners[1:-1], corners[2:]], axis=1)


def _values(content: dict[str, Any], blobs: list[bytes], accessor: dict[str, Any]) -> Array:
    """(count, width) an accessor's numbers; normalised integers as the fractions that they stand for."""
    count, width, kind = accessor["count"], _WIDTHS[accessor["type"]], accessor["componentType"]
    if "bufferView" in accessor:
        values = _view(content, blobs, accessor, count, width, kind)
    else:
        values = np.zeros((count, width), dtype=_TYPES[kind])
    if "sparse" in accessor:
        sparse = accessor["sparse"]
        rows = _view(content, blobs, sparse["indices"], sparse["count"], 1, sparse["indices"]["componentType"])
        values = values.copy()
        values[rows[:, 0]] = _view(content, blobs, sparse["values"], sparse["count"], width, kind)
    if accessor.get("normalized") and kind in _DIVISORS:
        return np.asarray(np.maximum(values / _DIVISORS[kind], -1.0))
    return values


def _view(content: dict[str, Any], blobs: list[bytes], at: dict[str, Any], count: int, width: int, kind: int) -> Array:
    """(count, width) numbers of a buffer view, from `at`'s offset on."""
    view, dtype = content["bufferViews"][at["bufferView"]], np.dtype(_TYPES[kind])
    if "extensions" in view:
        names = ", ".join(view["extensions"])
        raise DataError(f"its numbers are not in the file's own buffer as they are ({names[:80]}); export it without "
                        "compression")
    start, offset = view.get("byteOffset", 0), at.get("byteOffset", 0)
    stride = view.get("byteStride", width * dtype.itemsize)
    part = blobs[view["buffer"]][start : start + view["byteLength"]]
    if count and offset + (count - 1) * stride + width * dtype.itemsize > len(part):
        raise DataError(f"an accessor reads beyond the {len(part)} bytes of its view; the file is damaged or cut off")
    return np.ndarray((count, width), dtype, part, offset, (stride, dtype.itemsize))
