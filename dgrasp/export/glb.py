"""Export a sequence as a binary glTF 2.0 file (GLB): hand parts, object and table as nodes with keyframe animation."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from dgrasp.export.sequence import StoredSequence
from dgrasp.scene.scene import TABLE_SIZE, TABLE_XY
from dgrasp.types import Array
from dgrasp.view.meshes import Mesh, body_poses, table_tops

_CREASE = 0.66
"""rad. The edge between two faces stays sharp if their normals differ by more than this angle."""
_COLORS = {"hand": (0.86, 0.72, 0.60), "object": (0.16, 0.50, 0.74), "table": (0.80, 0.80, 0.78)}
_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""The rotation (x, y, z, w) from the world frame, z up, to glTF's frame, y up."""
_FLOAT, _UINT, _VERTICES, _INDICES = 5126, 5125, 34962, 34963


def glb_bytes(sequence: StoredSequence) -> bytes:
    """The bytes of the file. Its node `dgrasp` rotates z up to y up; nodes below it are in the world frame, m."""
    record, meshes = sequence.record, sequence.meshes
    file = _File()
    q, t = body_poses(meshes, record)
    times = file.accessor(np.arange(len(t)) * record.dt, "SCALAR", bounds=True)
    nodes: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []

    def animate(node: int, path: str, keys: int, values: Array, kind: str, how: str) -> None:
        samplers.append({"input": keys, "output": file.accessor(values, kind), "interpolation": how})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})

    for body, name in enumerate(meshes.bodies):
        shape = meshes.object if name == "object" else meshes.hand[body]
        nodes.append({"name": record.label.object_id if name == "object" else name})
        if len(shape.faces):
            nodes[-1]["mesh"] = file.mesh(nodes[-1]["name"], shape, "object" if name == "object" else "hand")
        nodes[-1] |= {"translation": t[0, body].tolist(), "rotation": q[0, body, [1, 2, 3, 0]].tolist()}
        animate(body, "translation", times, t[:, body], "VEC3", "LINEAR")
        animate(body, "rotation", times, q[:, body][:, [1, 2, 3, 0]], "VEC4", "LINEAR")
    tops = table_tops(record, sequence.about["table"]["top_m"], sequence.about["table"]["lowered_m"])
    places = np.array([[*TABLE_XY, top - TABLE_SIZE[2] / 2] for top in tops])
    nodes.append({"name": "table", "mesh": file.mesh("table", _box(TABLE_SIZE), "table"),
                  "translation": places[0].tolist()})
    changes = np.flatnonzero(np.diff(tops)) + 1
    if len(changes):
        keys = np.array([0, *changes])
        animate(len(nodes) - 1, "translation", file.accessor(keys * record.dt, "SCALAR", bounds=True), places[keys],
                "VEC3", "STEP")
    nodes.append({"name": "dgrasp", "rotation": _UP, "children": list(range(len(nodes)))})
    about, data = sequence.about, sequence.about["data"]
    return file.bytes({
        "asset": {"version": "2.0", "generator": "dgrasp", "extras": {
            "method": about["method"], "engine": about["engine"], "object": record.label.object_id,
            "index": record.label.index, "labels": data.get("labels"), "licence": data.get("licence"),
            "inertia": data.get("inertia"),
            "table_gone_s": None if record.table_stays else record.window_start * record.dt,
        }},
        "scene": 0, "scenes": [{"name": "grasp", "nodes": [len(nodes) - 1]}], "nodes": nodes,
        "animations": [{"name": "grasp", "channels": channels, "samplers": samplers}],
    })  # fmt: skip


class _File:
    """Collects binary data, and the JSON that describes it."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []

    def accessor(self, values: Array, kind: str, target: int | None = None, bounds: bool = False) -> int:
        """Add an array and return its index. Stored as uint32 for indices, else float32. bounds: add min and max."""
        packed = np.ascontiguousarray(values, dtype="<u4" if target == _INDICES else "<f4")
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._size, "byteLength": packed.nbytes}
        self._views.append(view if target is None else {**view, "target": target})
        self._parts.append(packed.tobytes())
        self._size += packed.nbytes
        entry: dict[str, Any] = {
            "bufferView": len(self._views) - 1, "componentType": _UINT if target == _INDICES else _FLOAT,
            "count": len(packed), "type": kind,
        }  # fmt: skip
        if bounds:
            rows = packed.reshape(len(packed), -1)
            entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self._accessors.append(entry)
        return len(self._accessors) - 1

    def mesh(self, name: str, shape: Mesh, material: str) -> int:
        """Add a mesh with normals and return its index; edges above `_CREASE` stay sharp."""
        import trimesh  # Imported here because it takes a second.

        whole = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
        smooth = trimesh.graph.smooth_shade(whole, angle=_CREASE)
        normals = np.array(smooth.vertex_normals)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(length > 1e-9, normals / np.maximum(length, 1e-9), [0.0, 0.0, 1.0])
        attributes = {"POSITION": self.accessor(smooth.vertices, "VEC3", _VERTICES, bounds=True),
                      "NORMAL": self.accessor(normals, "VEC3", _VERTICES)}
        indices = self.accessor(np.asarray(smooth.faces).reshape(-1), "SCALAR", _INDICES)
        primitive = {"attributes": attributes, "indices": indices, "material": list(_COLORS).index(material)}
        self._meshes.append({"name": name, "primitives": [primitive]})
        return len(self._meshes) - 1

    def bytes(self, document: dict[str, Any]) -> bytes:
        """The bytes of the file. document: the glTF document without materials, meshes and buffers."""
        materials = [
            # glTF's colours are linear, ours sRGB.
            {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [*(c**2.2 for c in color), 1.0],
                                                    "metallicFactor": 0.0, "roughnessFactor": 0.8}}
            for name, color in _COLORS.items()
        ]  # fmt: skip
        whole = {**document, "materials": materials, "meshes": self._meshes, "accessors": self._accessors,
                 "bufferViews": self._views, "buffers": [{"byteLength": self._size}]}
        text = json.dumps(whole, separators=(",", ":"), allow_nan=False).encode("utf-8")
        text += b" " * (-len(text) % 4)
        binary = b"".join(self._parts)
        head = struct.pack("<III", 0x46546C67, 2, 12 + 8 + len(text) + 8 + len(binary))
        return (head + struct.pack("<II", len(text), 0x4E4F534A) + text
                + struct.pack("<II", len(binary), 0x004E4942) + binary)


def _box(size: tuple[float, float, float]) -> Mesh:
    import trimesh

    box = trimesh.creation.box(size)
    return Mesh(np.asarray(box.vertices), np.asarray(box.faces))
