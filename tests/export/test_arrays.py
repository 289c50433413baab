from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dgrasp.config.experiment import make_config
from dgrasp.errors import DataError
from dgrasp.export import collect
from dgrasp.export.arrays import npz_bytes, sequence_arrays
from dgrasp.hand.mano.file import read_mano
from dgrasp.hand.mano.layout import mano_kinematics
from dgrasp.hand.mano.pose import project_pose
from dgrasp.hand.mano.skeleton import N_PARTS, PART_PARENT
from dgrasp.hand.mano.skinning import axis_angle_rotations, euler_rotations
from tests.eval.records import standing
from tests.export.sequences import STEPS, episode, sequence
from tests.hand.mano_file import write_mano
from tests.scenes import free_hand


def test_arrays_are_the_recorded_ones() -> None:
    one = sequence(T_WG=standing(np.eye(4), STEPS))
    arrays = sequence_arrays(one)
    assert arrays["joint_angles"] == pytest.approx(one.record.gc[:, 6:])
    assert arrays["wrist_position"][0] == pytest.approx([0.5, 0.1, 0.7])
    # The object has turned by 0.1 rad about x in step 1: w = cos(0.05), x = sin(0.05).
    assert np.abs(arrays["object_quaternion"][1]) == pytest.approx([np.cos(0.05), np.sin(0.05), 0.0, 0.0], abs=1e-9)
    assert arrays["contact_force"][2, 15] == pytest.approx(3.0)
    assert arrays["table_top"].tolist() == [0.5] * STEPS
    assert sequence_arrays(sequence())["table_top"].tolist() == [0.5] * 3 + [0.25] * 5
    assert arrays["object_target"].shape == (STEPS, 4, 4)
    assert not any(name.startswith("mano") for name in arrays)


def test_a_hand_that_is_not_manos_says_so() -> None:
    with np.load(io.BytesIO(npz_bytes(sequence()))) as archive:
        meta = json.loads(str(archive["meta"]))
    assert meta["mano"] == "none: the hand 'free' was not made from a MANO file"
    assert meta["data"]["licence"] == "MIT" and meta["parts"][15] == "thumb_distal"


@pytest.mark.parametrize(("file", "expected"), [("free_skin.npz", None), ("MANO_LEFT.pkl", [0.5])])
def test_a_hand_built_of_the_free_skin_is_not_manos(
    monkeypatch: pytest.MonkeyPatch, file: str, expected: list[float] | None
) -> None:
    meta = {"model_file": file, "side": "left", "betas": [0.5]}
    monkeypatch.setattr(collect, "is_built_hand", lambda folder: True)
    monkeypatch.setattr(collect, "built_hand", lambda folder: (Path("hand.urdf"), "hand", meta))
    choice: Any = SimpleNamespace(hand_urdf=Path("hands/mine/hand.urdf"))
    found = collect.mano_origin(choice, free_hand(), make_config({}, "test"))
    assert found == (None if expected is None else {"side": "left", "betas": expected})


def test_manos_parameters_pose_manos_mesh_as_the_hand_was(tmp_path: Path) -> None:
    file = write_mano(tmp_path / "MANO_RIGHT.pkl")
    model = read_mano(file)
    betas = np.array([0.4, -0.3])
    _, joints = model.shaped(betas)
    offsets = np.array([joints[i] - joints[PART_PARENT[i]] if i else np.zeros(3) for i in range(N_PARTS)])
    one = sequence({"side": "right", "betas": betas.tolist()})
    object.__setattr__(one, "meshes", replace(one.meshes, chain=mano_kinematics(offsets)))
    assert "mano_transl" not in sequence_arrays(one)
    arrays = sequence_arrays(one, file)
    record = one.record
    assert arrays["mano_betas"] == pytest.approx([0.4, -0.3] + [0.0] * 8)
    # MANO turns its mesh about the root joint and then shifts it by the translation.
    assert arrays["mano_transl"] + joints[0] == pytest.approx(record.T_WH[:, :3, 3])
    assert axis_angle_rotations(arrays["mano_global_orient"]) == pytest.approx(record.T_WH[:, :3, :3], abs=1e-9)
    angles = project_pose(arrays["mano_hand_pose"])
    assert euler_rotations(angles.reshape(-1, 3)) == pytest.approx(euler_rotations(record.gc[:, 6:].reshape(-1, 3)),
                                                                   abs=1e-9)
    with pytest.raises(DataError, match="expected the model that the hand was made from"):
        sequence_arrays(sequence({"side": "right", "betas": []}), file)


def test_a_known_root_joint_needs_no_file() -> None:
    arrays = sequence_arrays(sequence({"side": "left", "betas": [], "root_joint": [0.1, 0.0, 0.0]}))
    assert arrays["mano_transl"] == pytest.approx(episode().T_WH[:, :3, 3] - [0.1, 0.0, 0.0])
