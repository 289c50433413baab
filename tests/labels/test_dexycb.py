"""Recordings of DexYCB from disk: the frames of a grasp, and files that are not as they should be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from dgrasp.errors import DataError
from dgrasp.labels.recorded.dexycb import Calibration, read_sequence, read_track
from dgrasp.labels.recorded.dexycb_grasps import find_frames
from dgrasp.labels.recorded.skips import Skip
from tests.labels.mini_dexycb import FRAMES, MiniDexYcb, standard


def test_frames_by_hand(mini: MiniDexYcb) -> None:
    track = read_track(read_sequence(mini.add("s1", "a", standard())))
    wrists = track.T_CO[:, :3, 3] + [0.1, 0, 0]
    assert find_frames(track, wrists, 0.01, 0.2) == (22, None)
    wrists[:5] += 1.0
    assert find_frames(track, wrists, 0.01, 0.2) == (22, 5)
    # Nearer once before: the approach is the last one.
    wrists[2] -= 1.0
    assert find_frames(track, wrists, 0.01, 0.2) == (22, 5)
    assert find_frames(track, wrists, 0.0041, 0.2) == (21, 5)
    wrists[21] += 1.0
    # The first frame within the distance is the grasp itself: there is no approach.
    assert find_frames(track, wrists, 0.01, 0.2) == (22, None)
    # A wrist at 0.25 m when it grasps, farther than the start's distance: from 0.30 m on it approaches.
    wrists = track.T_CO[:, :3, 3] + [0.25, 0, 0]
    wrists[:8] += [0.04, 0, 0]
    wrists[:6] += [0.02, 0, 0]
    assert find_frames(track, wrists, 0.01, 0.2) == (22, 6)
    with pytest.raises(Skip, match="far from the object"):
        find_frames(track, wrists + np.array([0.2, 0, 0]), 0.01, 0.2)
    with pytest.raises(Skip, match="not moved"):
        find_frames(track, wrists, 0.5, 0.2)


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("meta.yml", {"ycb_ids": [3] * 30}, "ycb_ids is no list"),
        ("meta.yml", {"ycb_grasp_ind": 3}, "names none of the 3 objects"),
        ("meta.yml", {"ycb_grasp_ind": True}, "names none"),
        ("meta.yml", {"num_frames": 10**9}, "num_frames"),
        ("meta.yml", {"mano_sides": ["both"]}, "mano_sides"),
        ("meta.yml", {"mano_calib": ["../../../etc"]}, "mano_calib names no calibration"),
        ("meta.yml", {"extrinsics": 7}, "extrinsics names no calibration"),
        ("meta.yml", {"num_frames": 39}, "pose_m has shape (40, 1, 51); expected (39, 1, 51)"),
        ("pose.npz", {"pose_y": np.zeros((FRAMES, 2, 7))}, "pose_y has shape"),
        ("pose.npz", {"pose_m": np.full((FRAMES, 1, 51), np.nan)}, "pose_m holds NaN"),
        ("pose.npz", {"pose_m": np.full((FRAMES, 1, 51), 30.0)}, "beyond 10 m"),
        ("pose.npz", {"pose_m": np.full((FRAMES, 1, 51), 9.0)}, "angle beyond 2 pi"),
        ("pose.npz", {"pose_y": np.full((FRAMES, 3, 7), 2.0)}, "not of length 1"),
        ("pose.npz", {"pose_m": np.array([{}], dtype=object)}, "pose_m announces"),
    ],
)
def test_bad_sequences(mini: MiniDexYcb, file: str, change: dict[str, object], message: str) -> None:
    folder = mini.add("s1", "a", standard())
    if file == "meta.yml":
        meta = yaml.safe_load((folder / file).read_text())
        (folder / file).write_text(yaml.dump(meta | change))
    else:
        with np.load(folder / file) as content:
            np.savez(folder / file, **(dict(content) | change))
    with pytest.raises(DataError) as caught:
        read_track(read_sequence(folder))
    assert message in str(caught.value) and str(folder / file if "shape (40" not in message else folder) in str(
        caught.value
    )


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        ({}, "no extrinsics of cameras and apriltag"),
        ({"apriltag": (1.0,) * 12}, "no extrinsics"),
        ({"1": (1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0), "apriltag": (1.0,) * 12}, "not a rotation"),
        ({"1": (1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0), "apriltag": (1.0,) * 11}, "a list of 12 finite numbers"),
        ({"1": (1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1), "2": (1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, -1),
          "apriltag": (1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)}, "on both sides of the tag's plane, or in it"),
        ({"1": (1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1e5), "apriltag": (1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)},
         "beyond 10 m"),
    ],
)  # fmt: skip
def test_bad_extrinsics(tmp_path: Path, poses: dict[str, object], message: str) -> None:
    folder = tmp_path / "calibration" / "extrinsics_x"
    folder.mkdir(parents=True)
    (folder / "extrinsics.yml").write_text(yaml.dump({"extrinsics": poses}, Dumper=yaml.Dumper))
    calibration = Calibration(tmp_path)
    for _ in range(2):
        with pytest.raises(DataError, match=message):
            calibration.world("x")
