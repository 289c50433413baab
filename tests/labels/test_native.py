from __future__ import annotations

import dataclasses
import io
import json
import re
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dgrasp.errors import DataError
from dgrasp.hand.layout import HandNames
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels.formats.native import MAX_BYTES, names_of, read_native, read_native_with_meta, write_native
from dgrasp.types import GraspLabel, StartPose
from tests.labels.files import make_labels

ARRAYS = ("hand_pose", "T_WH", "T_WO", "joints_W", "goal_contacts")


def same(one: GraspLabel, two: GraspLabel) -> None:
    for field in ARRAYS:
        a, b = getattr(one, field), getattr(two, field)
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype
    for field in ("object_id", "hand", "source", "index", "on_table"):
        assert getattr(one, field) == getattr(two, field)
    assert (one.start is None) == (two.start is None)
    if one.start is not None and two.start is not None:
        for field in ("T_WH", "T_WO", "hand_pose"):
            np.testing.assert_array_equal(getattr(one.start, field), getattr(two.start, field))


def repack(path: Path, **changes: Any) -> Path:
    """The same file with members replaced (an array), removed (None), or of raw bytes; `meta` takes a dict."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for name, value in changes.items():
        if isinstance(value, dict):
            meta = json.loads(str(np.load(io.BytesIO(members["meta.npy"]))))
            value = np.array(json.dumps({k: v for k, v in {**meta, **value}.items() if v is not None}))
        if isinstance(value, np.ndarray):
            stream = io.BytesIO()
            np.save(stream, value, allow_pickle=True)
            value = stream.getvalue()
        members[f"{name}.npy"] = value
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, raw in members.items():
            if raw is not None:
                archive.writestr(name, raw)
    return path


@pytest.fixture
def native(tmp_path: Path) -> Path:
    write_native(tmp_path / "a.npz", make_labels(), {"made": "by a test"}, "CC0-1.0", MANO_NAMES)
    return tmp_path / "a.npz"


@pytest.mark.parametrize(("n", "seed"), [(1, 0), (4, 1), (31, 2)])
def test_round_trip_is_exact(tmp_path: Path, n: int, seed: int) -> None:
    labels = make_labels(n, seed=seed)
    write_native(tmp_path / "a.npz", labels, {"made": ["by", 1]}, "CC0-1.0", MANO_NAMES)
    again, meta = read_native_with_meta(tmp_path / "a.npz")
    assert len(again) == n
    for one, two in zip(labels, again, strict=True):
        same(one, two)
    assert (meta["hand"], meta["licence"], meta["provenance"]) == ("free", "CC0-1.0", {"made": ["by", 1]})
    assert meta["units"]["length"] == "m"


def test_bytes_depend_on_the_content_alone(tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        write_native(tmp_path / name, make_labels(), "p", "l", MANO_NAMES)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_failed_write_leaves_the_old_file(native: Path) -> None:
    before = native.read_bytes()
    bad = make_labels()
    bad[2].joints_W[3, 1] = np.nan
    with pytest.raises(DataError, match=r"025_mug\[0\]: joints_W holds NaN"):
        write_native(native, bad, "p", "l", MANO_NAMES)
    assert native.read_bytes() == before
    assert [p.name for p in native.parent.iterdir()] == ["a.npz"]


def test_unwritable_place(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        write_native(tmp_path / "file" / "a.npz", make_labels(), "p", "l", MANO_NAMES)


def _with(**changes: Any) -> list[GraspLabel]:
    labels = make_labels()
    return [dataclasses.replace(labels[0], **changes), *labels[1:]]


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ([], "0 hands"),
        (_with(hand="other"), "labels of 2 hands"),
        (_with(hand_pose=np.zeros(44)), "hand_pose has shape (44,)"),
        (_with(T_WO=2.0 * np.eye(4)), "T_WO is not a rigid transform"),
        (_with(T_WO=np.diag([1.0, 1.0, -1.0, 1.0])), "T_WO is not a rigid transform"),
        (_with(goal_contacts=np.full(16, 0.5)), "goal_contacts does not fit bool"),
        (_with(index=-1), "negative index"),
        (_with(object_id="../x"), "object name '../x'"),
        (_with(source="a\x1bb"), "no table of sources"),
    ],
)
def test_bad_labels_are_not_written(tmp_path: Path, labels: list[GraspLabel], message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)):
        write_native(tmp_path / "a.npz", labels, "p", "l", MANO_NAMES)
    assert not (tmp_path / "a.npz").exists()


@pytest.mark.parametrize("provenance", [{"x": object()}, {"x": float("nan")}])
def test_provenance_must_be_json(tmp_path: Path, provenance: dict[str, Any]) -> None:
    with pytest.raises(DataError, match="provenance"):
        write_native(tmp_path / "a.npz", make_labels(), provenance, "l", MANO_NAMES)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"meta": {"schema": 3}}, "schema 3 is newer than this program, which reads 2; update the program"),
        ({"meta": {"schema": 0}}, "schema 0; expected 1 to 2"),
        ({"meta": {"schema": "1"}}, "no schema number"),
        ({"meta": {"schema": 3}, "surprise": np.zeros(1)}, "newer"),
        ({"meta": {"joints": None}}, "no table of joints"),
        ({"meta": {"parts": ["palm", "palm"]}}, "2 names of parts, or one of them twice"),
        ({"meta": {"keypoints": ["wrist"]}}, "joints_W is float64 of shape (4, 21, 3); expected"),
        ({"meta": {"format": "other"}}, "its description is not that of a label file"),
        ({"meta": {"units": {"length": "mm"}}}, "units other than"),
        ({"meta": {"hand": None}}, "no hand"),
        ({"meta": {"licence": "a\x1b[2Jb"}}, "no licence"),
        ({"meta": {"provenance": 3}}, "no provenance"),
        ({"meta": {"objects": "mug"}}, "no table of objects"),
        ({"meta": {"objects": ["../../etc", "x"]}}, "object name '../../etc'"),
        ({"meta": {"objects": ["x"]}}, "label 2: its object is not in the table of 1 names"),
        ({"meta": np.array("{")}, "description"),
        ({"meta": np.array("[" * 100_000)}, "description"),
        ({"meta": np.array(["{}"])}, "description"),
        ({"meta": np.array(3)}, "meta announces"),
        ({"joints_W": None}, "lacks joints_W.npy"),
        ({"surprise": np.zeros(1)}, "also has surprise.npy"),
        ({"meta": None}, "lacks meta.npy"),
        ({"joints_W": np.zeros((3, 21, 3))}, "joints_W is float64 of shape (3, 21, 3); expected float64"),
        ({"joints_W": np.zeros((4, 21, 3), dtype=np.float32)}, "joints_W is float32"),
        ({"joints_W": np.zeros((4, 21, 3), dtype=">f8")}, "joints_W is >f8"),
        ({"joints_W": np.zeros((4, 21, 3), dtype=int)}, "joints_W announces"),
        ({"hand_pose": np.array([{}] * 4, dtype=object)}, "hand_pose announces (4,) of |O"),
        ({"hand_pose": np.full((4, 45), np.nan)}, "004_sugar_box[0]: hand_pose holds NaN"),
        ({"hand_pose": np.full((4, 45), 90.0)}, "004_sugar_box[0]: hand_pose has an angle"),
        ({"start_T_WH": np.zeros((4, 4, 4))}, "004_sugar_box[0]: start_T_WH is not a rigid transform"),
        ({"T_WO": np.full((4, 4, 4), 1e300)}, "T_WO lies beyond"),
        ({"joints_W": np.zeros((4, 21, 3))}, "wrist key point"),
        ({"object": np.array([0, 0, 0, -1], dtype=np.int32)}, "label 3: its object"),
        ({"object": np.zeros(0, dtype=np.int32)}, "no labels"),
        ({"object": np.array(0, dtype=np.int32)}, "no labels"),
        ({"T_WO": b"not an array"}, "damaged label file"),
        ({"T_WO": b""}, "damaged label file"),
    ],
)
def test_bad_files(native: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=re.escape(f"{native}: ") + ".*" + re.escape(message)):
        read_native(repack(native, **changes))


def test_a_file_of_schema_1_is_of_a_hand_with_manos_joints(native: Path) -> None:
    """Its description names no joints, parts and key points; it is read for good."""
    before = read_native(native)
    old = repack(native, meta={"schema": 1, "joints": None, "parts": None, "keypoints": None})
    labels, meta = read_native_with_meta(old)
    assert names_of(meta) == MANO_NAMES
    for one, other in zip(before, labels, strict=True):
        assert np.array_equal(one.hand_pose, other.hand_pose) and np.array_equal(one.joints_W, other.joints_W)


def test_labels_of_any_hand_are_read_back(tmp_path: Path) -> None:
    names = HandNames(("a", "b"), ("palm", "left", "right"), ("wrist", "left", "left_tip", "right"))
    start = StartPose(np.eye(4), np.eye(4), np.array([0.1, 0.2]))
    label = GraspLabel("x", np.array([0.3, 0.4]), np.eye(4), np.eye(4), np.zeros((4, 3)), np.array([True, False, True]),
                       start, "claw", "test", 0)
    write_native(tmp_path / "a.npz", [label], "made up", "MIT", names)
    (read,), meta = read_native_with_meta(tmp_path / "a.npz")
    assert names_of(meta) == names and meta["schema"] == 2
    assert read.hand_pose.tolist() == [0.3, 0.4] and read.goal_contacts.tolist() == [True, False, True]
    assert read.joints_W.shape == (4, 3) and read.start is not None and read.start.hand_pose.tolist() == [0.1, 0.2]
    with pytest.raises(DataError, match=r"hand_pose has shape \(2,\); expected \(45,\)"):
        write_native(tmp_path / "b.npz", [label], "made up", "MIT", MANO_NAMES)


def _bomb(path: Path, announced: int | None) -> Path:
    """An archive whose meta.npy unpacks to more than allowed; `announced` is the size that it claims."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.npy", bytes(MAX_BYTES + 1))
    if announced is not None:
        raw = bytearray(path.read_bytes())
        # Uncompressed size: offset 22 of the local header, 24 of the central one.
        struct.pack_into("<I", raw, 22, announced)
        struct.pack_into("<I", raw, raw.rfind(b"PK\x01\x02") + 24, announced)
        path.write_bytes(raw)
    return path


def test_zip_bombs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="when unpacked"):
        read_native(_bomb(tmp_path / "a.npz", None))
    with pytest.raises(DataError, match="damaged label file"):
        read_native(_bomb(tmp_path / "b.npz", 1000))


def test_header_that_announces_more_than_it_holds(native: Path) -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 45), }"
    raw = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + 1) + header + b"\n"
    with pytest.raises(DataError, match="hand_pose announces"):
        read_native(repack(native, hand_pose=raw))


def test_twice_the_same_member(native: Path) -> None:
    with zipfile.ZipFile(native, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("T_WO.npy", b"")
    with pytest.raises(DataError, match="expected the members"):
        read_native(native)


def test_unusual_compression(native: Path) -> None:
    with zipfile.ZipFile(native, "a", zipfile.ZIP_LZMA) as archive:
        archive.writestr("more.npy", b"x" * 100)
    with pytest.raises(DataError, match="unusual way"):
        read_native(native)


def test_oversized_missing_and_folder(tmp_path: Path) -> None:
    big = tmp_path / "big.npz"
    with big.open("wb") as stream:
        stream.truncate(MAX_BYTES + 1)
    with pytest.raises(DataError, match="at most"):
        read_native(big)
    for path in (tmp_path / "none.npz", tmp_path):
        with pytest.raises(DataError, match="cannot be read"):
            read_native(path)
