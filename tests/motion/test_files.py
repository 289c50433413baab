"""Targets from users' files, good and bad."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dgrasp.errors import DataError
from dgrasp.motion.files import read_target, read_targets
from dgrasp.motion.targets import EASY_FILE
from tests.reference import reference_or_skip

PERIOD = 0.1
HALF = [np.cos(0.25), 0.0, 0.0, np.sin(0.25)]
"""Half a radian about z."""
LIST = {"frame": "label", "position": [[0.0, 0.0, 0.1], [0.1, 0.0, 0.2]], "quaternion": [[1.0, 0.0, 0.0, 0.0], HALF]}


def written(folder: Path, content: object, name: str = "t.json") -> Path:
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_the_three_formats_say_the_same(tmp_path: Path) -> None:
    rows = ["t,dx,dy,dz,qw,qx,qy,qz", "0,0,0,0.1,1,0,0,0", f"1,0.1,0,0.2,{HALF[0]},0,0,{HALF[3]}", ""]
    np.savez(tmp_path / "t.npz", time=[0.0, 1.0], **LIST)
    files = [written(tmp_path, {**LIST, "time": [0, 1]}), written(tmp_path, "\n".join(rows), "t.csv")]
    files.append(tmp_path / "t.npz")
    sets = [read_targets(file, PERIOD) for file in files]
    for targets in sets:
        assert targets.relative and targets.T.shape == (1, 10, 4, 4)
        assert np.allclose(targets.T, sets[0].T, atol=1e-12)
    assert np.allclose(sets[0].T[0, 4, :3, 3], [0.05, 0.0, 0.15])
    assert [targets.name for targets in sets] == ["t.json", "t.csv", "t.npz"]


def test_without_times_each_pose_is_a_target(tmp_path: Path) -> None:
    targets = read_targets(written(tmp_path, LIST), PERIOD)
    assert targets.T.shape == (2, 1, 4, 4)
    assert np.allclose(targets.T[1, 0, :2, :2], [[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])


def test_world_columns_are_absolute(tmp_path: Path) -> None:
    targets = read_targets(written(tmp_path, "qw,qx,qy,qz,x,y,z\n1,0,0,0,0.5,0,0.8\n", "t.csv"), PERIOD)
    assert not targets.relative and targets.T[0, 0, :3, 3].tolist() == [0.5, 0.0, 0.8]


def test_the_authors_file_is_known_by_its_content() -> None:
    assert len(read_targets(reference_or_skip() / "labels" / EASY_FILE, PERIOD).T) == 100


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"frame": "object"}, "frame is 'object'"),
        ({"frame": None}, "frame is None"),
        ({"position": [[0, 0, 0.1]]}, "1 positions and 2 quaternions"),
        ({"position": [], "quaternion": []}, "position is not a plain array"),
        ({"position": [[0, 0, 0.1], [0, 0, float("nan")]]}, "row 1: position is not finite"),
        ({"position": [[0, 0, 150.0], [0, 0, 150.0]]}, r"row 0: the position is beyond 10 m.*\(2 rows"),
        ({"position": [[0, 0], [0, 0]]}, "position is not a plain array"),
        ({"position": [["a", 0, 0], [0, 0, 0]]}, "position is not a plain array"),
        ({"position": [[0, 0, 10**400], [0, 0, 0]]}, "position is not a plain array"),
        ({"quaternion": [[1, 0, 0, 0], [0, 0, 0, 0]]}, "row 1: the quaternion is not of length 1"),
        ({"quaternion": 3}, "quaternion is not a plain array"),
        ({"time": [0]}, "1 times for 2 poses"),
        ({"time": [1, 1]}, "row 1: the time is not later"),
        ({"time": [0, 1000]}, "expected 0 to 300 s"),
        ({"time": [-1, 1]}, "expected 0 to 300 s"),
    ],
)
def test_bad_json(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    path = written(tmp_path, {**LIST, **changes})
    with pytest.raises(DataError, match=said) as caught:
        read_targets(path, PERIOD)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("t.json", "{\"frame\": ", "not valid JSON"),
        ("t.csv", "", "columns nothing"),
        ("t.csv", "x,y,z\n1,2,3\n", "columns x, y, z"),
        ("t.csv", "x,y,z,qw,qx,qy,qz\n", "no rows"),
        ("t.csv", "x,y,z,qw,qx,qy,qz\n0,0,0,1,0,0\n", "row 0: not every column"),
        ("t.csv", "x,y,z,qw,qx,qy,qz\n0,0,0,1,0,0,up\n", "row 0: not every column"),
    ],
)
def test_bad_text(tmp_path: Path, name: str, content: str, said: str) -> None:
    with pytest.raises(DataError, match=said):
        read_targets(written(tmp_path, content, name), PERIOD)


def test_bad_bytes(tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    with pytest.raises(DataError, match="cannot be read"):
        read_targets(path, PERIOD)
    broken = ((b"PK\3\4 broken", "damaged"), (b"\xff\xfe\x00", "neither text nor"), (b"\x80\4.", "damaged"))
    for content, said in broken:
        path.write_bytes(content)
        with pytest.raises(DataError, match=said):
            read_targets(path, PERIOD)
    np.savez(path, position=np.array([object()]), quaternion=np.ones((1, 4)), frame="label")
    with pytest.raises(DataError, match="plain arrays"):
        read_targets(path, PERIOD)


def test_csv_of_spreadsheets_and_pandas(tmp_path: Path) -> None:
    for raw in (",x,y,z,qw,qx,qy,qz\n0,0.5,0.25,1,1,0,0,0\n".encode("utf-16"),
                b"x;y;z;qw;qx;qy;qz\r\n0,5;0,25;1;1;0;0;0\r\n"):
        (tmp_path / "a.csv").write_bytes(raw)
        T = read_targets(tmp_path / "a.csv", 0.01).T
        np.testing.assert_array_equal(T[0, 0, :3, 3], [0.5, 0.25, 1.0])


def test_one_target_as_words_or_as_a_file(tmp_path: Path) -> None:
    words = read_target(f"0.1 0 -0.2 {HALF[0]} 0 0 {HALF[3]}", PERIOD)
    rows = f"dx,dy,dz,qw,qx,qy,qz\n0.1,0,-0.2,{HALF[0]},0,0,{HALF[3]}\n"
    file = read_target(str(written(tmp_path, rows, "one.csv")), PERIOD)
    turned = [[np.cos(0.5), -np.sin(0.5), 0.0], [np.sin(0.5), np.cos(0.5), 0.0], [0.0, 0.0, 1.0]]
    for target in (words, file):
        assert target.relative and target.T.shape == (1, 1, 4, 4)
        assert np.allclose(target.T[0, 0, :3, 3], [0.1, 0.0, -0.2]) and np.allclose(target.T[0, 0, :3, :3], turned)
    assert np.array_equal(read_target("0,0,0.2", PERIOD).T[0, 0, :3], [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.2]])
    path = read_target(str(written(tmp_path, {**LIST, "time": [0, 1]}, "path.json")), PERIOD)
    assert path.T.shape == (1, 10, 4, 4)
    with pytest.raises(DataError, match=r"--to .*: 2 targets; expected one pose, or one trajectory"):
        read_target(str(written(tmp_path, LIST, "two.json")), PERIOD)
