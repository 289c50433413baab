"""A small DexYCB in the exact layout, with known poses: what the tests write and read again.

The world is the table: z up, its top at 0. The camera frame is where the recordings' poses are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from dgrasp.hand.mano.file import read_mano
from dgrasp.hand.mano.model import ManoModel
from dgrasp.types import Array
from raisim_like.rotations import transform
from tests.hand.mano_file import mano_arrays, write_mano

FRAMES = 40
SERIALS = ("836212060125", "839512060362", "840412060917")
T_CT = transform(Rotation.from_euler("xyz", [2.1, 0.3, 0.4]).as_matrix(), np.array([0.1, -0.2, 0.9]))
"""The tag in the camera frame: its z looks to the cameras."""
CAMERAS_T = np.array([[0.5, 0.0, 0.8], [0.2, 0.6, 0.7], [1.0, -0.3, 0.6]])
"""Where the cameras stand, in the tag's frame; the first is the master, but its orientation does not matter here."""


@dataclass
class Recording:
    """One sequence: poses in the tag's frame T. wrist (F, 3): of the hand, whose frame is turned by R_TH.

    place (F, 3): of the grasped object, which is turned by R_TO. pose (45,): MANO's rotation vectors, all frames alike.
    object: its DexYCB id; others lie about as well. hidden_hand, hidden_object: frames without annotation.
    """

    wrist: Array
    place: Array
    object: int = 3
    side: str = "right"
    R_TH: Array = field(default_factory=lambda: np.eye(3))
    R_TO: Array = field(default_factory=lambda: np.eye(3))
    pose: Array = field(default_factory=lambda: np.zeros(45))
    hidden_hand: tuple[int, ...] = ()
    hidden_object: tuple[int, ...] = ()


def approach() -> tuple[Array, Array]:
    """Wrist and object of the standard recording, (F, 3) each, in the tag's frame.

    The object rests at (0.6, 0.2, 0.1) and from frame 20 on rises by 4 mm a frame: 4, 8, 12 mm in frames 20, 21, 22,
    so that 10 mm are exceeded first in frame 22. The wrist stands 0.188 m beside it in x from frame 20 on; before, it
    comes nearer by 2.5 mm a frame: 0.2005 m in frame 15, 0.198 m in frame 16.
    """
    frames = np.arange(FRAMES)
    place = np.tile([0.6, 0.2, 0.1], (FRAMES, 1))
    place[:, 2] += 0.004 * np.clip(frames - 19, 0, None)
    wrist = place + np.array([0.188, 0.0, 0.0])
    wrist[:, 0] += 0.0025 * np.clip(20 - frames, 0, None)
    return wrist, place


def standard(**changes: Any) -> Recording:
    """The standard recording, with changes."""
    wrist, place = approach()
    return Recording(**{"wrist": wrist, "place": place, **changes})


@dataclass
class MiniDexYcb:
    """Writes a data set below `root`; an id of extrinsics with "down" in it has a tag that faces down."""

    root: Path
    model: ManoModel
    left: ManoModel
    betas: dict[str, list[float]] = field(default_factory=dict)

    def add(self, subject: str, sequence: str, recording: Recording, tag: str = "20200702_151821") -> Path:
        """Write one sequence and the calibrations that it names."""
        mano = f"{subject}_{recording.side}"
        betas = self.betas.setdefault(mano, [0.1 * len(self.betas)] * 10)
        folder = self.root / subject / sequence
        folder.mkdir(parents=True)
        T_camera_tag = T_CT if "down" not in tag else T_CT @ np.diag([1.0, -1.0, -1.0, 1.0])
        self._extrinsics(tag, T_camera_tag)
        self._yaml(f"calibration/mano_{mano}/mano.yml", {"betas": betas})
        ids = [5, recording.object, 21]
        meta = {"serials": list(SERIALS), "num_frames": len(recording.wrist), "extrinsics": tag, "ycb_ids": ids,
                "ycb_grasp_ind": 1, "mano_sides": [recording.side], "mano_calib": [mano]}
        self._yaml(f"{subject}/{sequence}/meta.yml", meta)
        np.savez_compressed(folder / "pose.npz", **self._poses(recording, np.array(betas), len(ids)))
        return folder

    def _poses(self, recording: Recording, betas: Array, n: int) -> dict[str, Array]:
        count = len(recording.wrist)
        model = self.model if recording.side == "right" else self.left
        # MANO puts the wrist at J0 + translation, and J0 is the regressed joint of the shape.
        J0 = (model.J_regressor @ (model.template + model.shape_basis @ betas))[0]
        R, t = T_CT[:3, :3], T_CT[:3, 3]
        hand = np.zeros((count, 1, 51), np.float32)
        hand[:, 0, :3] = Rotation.from_matrix(R @ recording.R_TH).as_rotvec()
        # The components are orthonormal: coefficients c of the pose mean + c @ components.
        hand[:, 0, 3:48] = (recording.pose - model.hands_mean) @ model.hands_components.T
        hand[:, 0, 48:] = recording.wrist @ R.T + t - J0
        hand[list(recording.hidden_hand)] = 0.0
        objects = np.zeros((count, n, 7), np.float32)
        objects[:, :, 3] = 1.0
        objects[:, :, 6] = 0.5
        objects[:, 1, :4] = Rotation.from_matrix(R @ recording.R_TO).as_quat()
        objects[:, 1, 4:] = recording.place @ R.T + t
        objects[list(recording.hidden_object), 1] = [0, 0, 0, 1, 0, 0, 0]
        return {"pose_m": hand, "pose_y": objects}

    def _extrinsics(self, tag: str, T_camera_tag: Array) -> None:
        poses = {}
        for serial, place in zip(SERIALS, CAMERAS_T, strict=True):
            T = transform(np.eye(3), T_CT[:3, :3] @ place + T_CT[:3, 3])
            poses[serial] = tuple(T[:3].ravel().tolist())
        poses["apriltag"] = tuple(T_camera_tag[:3].ravel().tolist())
        self._yaml(f"calibration/extrinsics_{tag}/extrinsics.yml", {"extrinsics": poses, "master": SERIALS[0]})

    def _yaml(self, path: str, content: Any) -> None:
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        # The full dumper writes tuples as !!python/tuple, as in the data set.
        file.write_text(yaml.dump(content, Dumper=yaml.Dumper))

    def mesh(self, name: str, low: Any, high: Any) -> None:
        """The model of an object: the box from corner `low` to corner `high` (m, its frame), as a bare OBJ file."""
        corners = [[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i in (0, 1) for j in (0, 1)
                   for k in (0, 1)]
        quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
        lines = [f"v {x} {y} {z}" for x, y, z in corners]
        lines += [f"f {a} {b} {c}\nf {a} {c} {d}" for a, b, c, d in quads]
        file = self.root / "models" / name / "textured_simple.obj"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("\n".join(lines) + "\n")


@cache
def mano_files() -> list[tuple[bytes, ManoModel]]:
    """The made-up MANO files of the right and the left hand, and what they hold; written and read once."""
    files = []
    with TemporaryDirectory() as folder:
        for side in ("right", "left"):
            path = write_mano(Path(folder) / f"{side}.pkl", mano_arrays(side=side))
            files.append((path.read_bytes(), read_mano(path)))
    return files


def make_mini(root: Path) -> tuple[MiniDexYcb, Path, Path]:
    """An empty data set with the models of objects 3 and 21, and MANO files of both hands: set, right, left."""
    root.mkdir(parents=True, exist_ok=True)
    paths = root / "MANO_RIGHT.pkl", root / "MANO_LEFT.pkl"
    for path, (raw, _) in zip(paths, mano_files(), strict=True):
        path.write_bytes(raw)
    right, left = paths
    mini = MiniDexYcb(root, *(model for _, model in mano_files()))
    mini.mesh("004_sugar_box", (-0.02, -0.045, -0.0875), (0.02, 0.045, 0.0875))
    mini.mesh("061_foam_brick", (-0.025, -0.0375, -0.025), (0.025, 0.0375, 0.025))
    return mini, right, left
