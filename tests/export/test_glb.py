"""The GLB file, read back according to the glTF 2.0 specification and with another library's reader."""

from __future__ import annotations

import io
import json
import struct
from typing import Any

import numpy as np
import pytest
import trimesh

from dgrasp.export.glb import glb_bytes
from dgrasp.hand.mano.skeleton import PARTS
from dgrasp.types import Array
from dgrasp.view.meshes import body_poses
from tests.eval.records import DT, standing
from tests.export.sequences import START, STEPS, episode, meshes, sequence

WIDTH = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


class Parsed:
    """The JSON document of a GLB and the arrays of its accessors."""

    def __init__(self, raw: bytes) -> None:
        magic, version, length = struct.unpack_from("<III", raw)
        assert (magic, version, length) == (0x46546C67, 2, len(raw)) and length % 4 == 0
        size, kind = struct.unpack_from("<II", raw, 12)
        assert kind == 0x4E4F534A and size % 4 == 0
        self.document: dict[str, Any] = json.loads(raw[20 : 20 + size])
        binary, kind = struct.unpack_from("<II", raw, 20 + size)
        assert kind == 0x004E4942 and binary % 4 == 0
        self.binary = raw[28 + size :]
        assert len(self.binary) == binary == self.document["buffers"][0]["byteLength"]

    def numbers(self, accessor: int) -> Array:
        entry = self.document["accessors"][accessor]
        view = self.document["bufferViews"][entry["bufferView"]]
        dtype = {5126: "<f4", 5125: "<u4"}[entry["componentType"]]
        width = WIDTH[entry["type"]]
        assert view["byteLength"] == 4 * width * entry["count"] and view["byteOffset"] % 4 == 0
        values = np.frombuffer(self.binary, dtype, entry["count"] * width, view["byteOffset"])
        return values.reshape(entry["count"], width)


@pytest.fixture(scope="module")
def file() -> Parsed:
    return Parsed(glb_bytes(sequence()))


def test_views_fill_the_buffer_without_overlap(file: Parsed) -> None:
    end = 0
    for view in file.document["bufferViews"]:
        assert view["byteOffset"] == end
        end += view["byteLength"]
    assert end == len(file.binary)
    for accessor in range(len(file.document["accessors"])):
        assert np.isfinite(file.numbers(accessor)).all()


def test_nodes_are_the_parts_the_object_and_the_table_below_one_that_turns_y_up(file: Parsed) -> None:
    nodes = file.document["nodes"]
    assert [node["name"] for node in nodes] == [*PARTS, "004_sugar_box", "table", "dgrasp"]
    root = nodes[-1]
    assert file.document["scenes"][0]["nodes"] == [18] and root["children"] == list(range(18))
    x, y, z, w = root["rotation"]
    # q (0, 0, 1) q* = (2 (xz + wy), 2 (yz - wx), 1 - 2 (x^2 + y^2)): up in the world is glTF's y.
    assert [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)] == pytest.approx([0, 1, 0])
    assert [("mesh" in node) for node in nodes[:17]] == [k in (0, 15, 16) for k in range(17)]


def test_meshes_are_indexed_within_bounds_with_unit_normals(file: Parsed) -> None:
    assert len(file.document["meshes"]) == 4
    for mesh in file.document["meshes"]:
        (primitive,) = mesh["primitives"]
        positions = file.numbers(primitive["attributes"]["POSITION"])
        normals = file.numbers(primitive["attributes"]["NORMAL"])
        indices = file.numbers(primitive["indices"])
        entry = file.document["accessors"][primitive["attributes"]["POSITION"]]
        assert entry["min"] == pytest.approx(positions.min(axis=0))
        assert entry["max"] == pytest.approx(positions.max(axis=0))
        assert len(normals) == len(positions) and len(indices) % 3 == 0 and indices.max() < len(positions)
        assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0, abs=1e-5)
        assert 0 <= primitive["material"] < len(file.document["materials"])
        # A box keeps its edges: each corner has one normal for each of its three sides.
        assert len(positions) == 24


def test_animation_is_the_recorded_motion(file: Parsed) -> None:
    (animation,) = file.document["animations"]
    targets = [(c["target"]["node"], c["target"]["path"]) for c in animation["channels"]]
    assert len(set(targets)) == len(targets) == 2 * 17 + 1
    q, t = body_poses(meshes(), episode())
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        times, values = file.numbers(sampler["input"])[:, 0], file.numbers(sampler["output"])
        entry = file.document["accessors"][sampler["input"]]
        assert len(times) == len(values) and (np.diff(times) > 0).all()
        assert entry["min"] == [times[0]] and entry["max"] == [times[-1]]
        node, path = channel["target"]["node"], channel["target"]["path"]
        if node == 17:
            assert sampler["interpolation"] == "STEP" and path == "translation"
            # The table's box is 0.5 m high: its middle is 0.25 m below its top.
            assert times == pytest.approx([0.0, START * DT]) and values[:, 2] == pytest.approx([0.25, 0.0])
            continue
        assert sampler["interpolation"] == "LINEAR" and times == pytest.approx(np.arange(STEPS) * DT)
        if path == "translation":
            assert values == pytest.approx(t[:, node], abs=1e-6)
        else:
            assert np.linalg.norm(values, axis=1) == pytest.approx(1.0, abs=1e-5)
            assert values[:, [3, 0, 1, 2]] == pytest.approx(q[:, node], abs=1e-6)
            # Interpolating the long way round would spin the part.
            assert ((values[1:] * values[:-1]).sum(axis=1) > 0).all()


def test_another_reader_finds_the_same_scene() -> None:
    scene = trimesh.load(io.BytesIO(glb_bytes(sequence())), file_type="glb")
    assert isinstance(scene, trimesh.Scene) and len(scene.geometry) == 4
    pose, _ = scene.graph["004_sugar_box"]
    # z up (0.6 m) has become y up, y has become -z.
    assert pose[:3, 3] == pytest.approx([0.5, 0.6, 0.0], abs=1e-6)


def test_a_motion_keeps_the_table_of_its_grasp() -> None:
    document = Parsed(glb_bytes(sequence(T_WG=standing(np.eye(4), STEPS)))).document
    assert all(c["target"]["node"] != 17 for c in document["animations"][0]["channels"])
    assert document["asset"]["extras"]["table_gone_s"] is None
    assert document["asset"]["extras"]["inertia"] == "true"


def test_a_table_that_is_gone_from_the_start_does_not_move() -> None:
    document = Parsed(glb_bytes(sequence(window_start=0))).document
    assert all(c["target"]["node"] != 17 for c in document["animations"][0]["channels"])
    assert document["nodes"][17]["translation"][2] == pytest.approx(0.0)
