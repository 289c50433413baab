from __future__ import annotations

import io
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dgrasp.errors import DataError
from dgrasp.export.sequence import check_folder, read_sequence, sequence_files, write_folder, write_sequence
from dgrasp.types import Array
from tests.eval.records import standing
from tests.export.sequences import STEPS, meshes, sequence


def test_reading_gives_back_what_was_written(tmp_path: Path) -> None:
    written = sequence({"side": "right", "betas": [0.5]}, T_WG=standing(np.eye(4), STEPS), terminated="NaN")
    write_sequence(tmp_path / "a.npz", written)
    read = read_sequence(tmp_path / "a.npz")
    for name in ("gc", "T_WH", "T_WO", "joints_W", "contacts", "contact_impulse", "table_contact", "reward"):
        assert getattr(read.record, name) == pytest.approx(getattr(written.record, name), abs=1e-7), name
    assert read.record.T_WG is not None and np.array_equal(read.record.T_WG, standing(np.eye(4), STEPS))
    assert (read.record.window_start, read.record.dt, read.record.terminated) == (3, written.record.dt, "NaN")
    for name in ("object_id", "hand", "source", "index", "on_table"):
        assert getattr(read.record.label, name) == getattr(written.record.label, name)
    assert read.record.label.goal_contacts.tolist() == written.record.label.goal_contacts.tolist()
    assert read.about == {key: value for key, value in written.about.items() if key != "code"}
    collision = written.meshes.colliding()
    assert np.ptp(collision.object.vertices, axis=0) == pytest.approx([0.08, 0.10, 0.06])
    pairs = zip((*read.meshes.hand, read.meshes.object, *read.meshes.shapes),
                (*written.meshes.hand, written.meshes.object, *collision.hand, collision.object), strict=True)
    for got, given in pairs:
        assert got.vertices == pytest.approx(given.vertices, abs=1e-7) and got.faces.tolist() == given.faces.tolist()


def test_a_file_may_hold_one_pose_for_a_target_that_stands(tmp_path: Path) -> None:
    pose = np.eye(4)
    pose[2, 3] = 0.75
    write_sequence(tmp_path / "a.npz", sequence(T_WG=standing(np.eye(4), STEPS)))
    with np.load(tmp_path / "a.npz") as archive:
        assert archive["target_T_WO"].shape == (STEPS, 4, 4)
        members = {**archive, "target_T_WO": pose.astype(np.float32)}
    np.savez_compressed(tmp_path / "b.npz", **members)
    T_WG = read_sequence(tmp_path / "b.npz").record.T_WG
    assert T_WG is not None and np.array_equal(T_WG, standing(pose, STEPS))


def test_a_folder_has_a_file_for_each_and_is_never_mixed_up(tmp_path: Path) -> None:
    folder = tmp_path / "new"
    assert write_folder(folder, [sequence(), sequence()]) == 2
    # Two labels can have the same object and index if they come from different sources.
    assert [file.name for file in sequence_files(folder)] == ["004_sugar_box_0000.npz", "004_sugar_box_0000_1.npz"]
    with pytest.raises(DataError, match="not an empty folder; choose another"):
        check_folder(folder)
    with pytest.raises(DataError, match="no stored sequences"):
        sequence_files(tmp_path / "none")


def changed(path: Path, **members: Any) -> Path:
    """The file with some members replaced, or removed if their value is None."""
    write_sequence(path, sequence())
    with np.load(path) as archive:
        arrays: dict[str, Array] = {name: archive[name] for name in archive.files}
    arrays |= {name: value for name, value in members.items() if value is not None}
    stream = io.BytesIO()
    np.savez(stream, **{name: value for name, value in arrays.items() if members.get(name, value) is not None})
    path.write_bytes(stream.getvalue())
    return path


def described(**changes: Any) -> Array:
    """The `meta` of a sequence with some entries changed."""
    with tempfile.TemporaryDirectory() as folder:
        write_sequence(Path(folder) / "a.npz", sequence())
        with np.load(Path(folder) / "a.npz") as archive:
            return np.array(json.dumps(json.loads(str(archive["meta"])) | changes))


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ({"gc": None}, "lacks gc"),
        ({"gc": np.zeros((8, 50), np.float32)}, r"gc has shape \(8, 50\); expected \(8, 51\)"),
        ({"T_WO": np.zeros((7, 4, 4), np.float32)}, "T_WO has shape"),
        ({"mesh_sizes": np.zeros((17, 2), np.int32)}, "do not add up"),
        ({"mesh_faces": np.full((36, 3), 9, np.int32)}, "a face of palm names a vertex that does not exist"),
        ({"shape_sizes": np.zeros((17, 2), np.int32)}, "shape_sizes do not add up to shape_vertices and shape_faces"),
        ({"shape_sizes": np.zeros((16, 2), np.int32)}, r"shape_sizes has shape \(16, 2\); expected \(17, 2\)"),
        ({"shape_faces": None}, "lacks shape_faces"),
        ({"shape_vertices": np.full((24, 3), np.nan, np.float32)}, "shape_vertices hold NaN"),
        ({"meta": np.array('{"format": "dgrasp-sequence", "schema": 3}')}, "schema 3; this program reads 1 to 2"),
        ({"meta": np.array('{"format": "dgrasp-sequence", "schema": 1}')}, "description is incomplete"),
        ({"meta": described(table={})}, r"incomplete or wrong \(table\)"),
        ({"meta": described(label={"object": "a", "index": "x", "source": "", "hand": "", "on_table": True})},
         r"wrong \(label\)"),
        ({"meta": described(mano="x")}, r"wrong \(mano\)"),
        ({"meta": described(window_start=-5)}, r"wrong \(window_start\)"),
        ({"offsets": np.full((16, 3), np.inf)}, "NaN or infinity"),
        ({"meta": np.array("[")}, "no stored sequence"),
        ({"meta": None}, "no member meta"),
    ],
)
def test_other_and_damaged_files_are_refused(tmp_path: Path, members: dict[str, Any], said: str) -> None:
    with pytest.raises(DataError, match=said):
        read_sequence(changed(tmp_path / "a.npz", **members))


def test_an_older_file_has_no_collision_shapes(tmp_path: Path) -> None:
    file = changed(tmp_path / "a.npz", shape_vertices=None, shape_faces=None, shape_sizes=None)
    assert read_sequence(file).meshes.shapes == () and len(read_sequence(file).meshes.object.faces) == 12
    with pytest.raises(DataError, match="without collision shapes; write it again"):
        read_sequence(file, shapes=True)
    write_sequence(tmp_path / "b.npz", replace(sequence(), meshes=replace(meshes(), shapes=())))
    assert read_sequence(tmp_path / "b.npz").meshes.shapes == ()


def test_a_file_that_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_bytes(b"PK nothing")
    with pytest.raises(DataError, match=r"a\.npz"):
        read_sequence(tmp_path / "a.npz")
