"""The hand model: forward kinematics against the URDF's own chain, and URDFs that are no such hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.errors import DataError
from dgrasp.files.joblib import read_joblib_arrays
from dgrasp.hand.free.hand import URDF_PATH
from dgrasp.hand.load import load_hand
from dgrasp.hand.mano.skeleton import KEYPOINTS, PARTS
from dgrasp.hand.model import HandModel
from dgrasp.types import Array
from raisim_like import World
from raisim_like.rotations import transform
from tests.raisim_like.urdfs import link_poses
from tests.reference import reference_or_skip


@pytest.fixture(scope="module")
def free_hand() -> HandModel:
    return load_hand(URDF_PATH, "free")


def coordinates(n: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """gc (n, 51), R_WH0 (n, 3, 3), wrist_start_W (n, 3)."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (n, 51)), Rotation.random(n, random_state=seed).as_matrix(), rng.normal(size=(n, 3))


def test_layout(free_hand: HandModel) -> None:
    assert free_hand.id == "free"
    assert free_hand.offsets.shape == (16, 3) and free_hand.tips.shape == (5, 3) and free_hand.limits.shape == (51, 2)
    assert free_hand.offsets[0].tolist() == [0, 0, 0]
    assert [free_hand.urdf.links[i].name for i in free_hand.part_links] == list(PARTS)
    assert (free_hand.limits[:, 0] < free_hand.limits[:, 1]).all()


def test_forward_kinematics_against_the_chain_of_joints(free_hand: HandModel) -> None:
    gc, R_WH0, start = coordinates(6)
    R_WH, joints = free_hand.forward(gc, R_WH0, start)
    for i in range(6):
        poses = transform(R_WH0[i], start[i]) @ link_poses(free_hand.urdf, gc[i])
        assert np.abs(R_WH[i] - poses[5][:3, :3]).max() < 1e-12
        for k, name in enumerate(KEYPOINTS):
            index, local = free_hand.urdf.frames["palm" if name == "wrist" else name]
            assert np.abs(joints[i, k] - (poses[index] @ local)[:3, 3]).max() < 1e-12


def test_forward_kinematics_against_the_engine(free_hand: HandModel) -> None:
    gc, _, start = coordinates(1)
    base = Rotation.from_rotvec([0.3, -0.8, 0.4])
    world = World()
    hand = world.add_articulated_system(free_hand.urdf)
    hand.set_base_pose(start[0], base.as_quat()[[3, 0, 1, 2]])
    hand.set_state(gc[0])
    R_WH, joints = free_hand.forward(gc, base.as_matrix()[None], start)
    for k, name in enumerate(KEYPOINTS):
        R, t = hand.frame_pose("palm" if name == "wrist" else name)
        assert np.abs(t - joints[0, k]).max() < 2e-6  # The engine reports frames in single precision.
        if k == 0:
            assert np.abs(R - R_WH[0]).max() < 2e-6
    world.close()


def test_moving_the_base_moves_everything(free_hand: HandModel) -> None:
    gc, R_WH0, start = coordinates(4)
    turn, shift = Rotation.from_rotvec([1.0, -0.4, 0.2]).as_matrix(), np.array([0.1, 0.2, 0.3])
    R, joints = free_hand.forward(gc, R_WH0, start)
    R_moved, joints_moved = free_hand.forward(gc, turn @ R_WH0, start @ turn.T + shift)
    assert np.abs(R_moved - turn @ R).max() < 1e-12
    assert np.abs(joints_moved - (joints @ turn.T + shift)).max() < 1e-12


def test_a_batch_is_its_rows(free_hand: HandModel) -> None:
    gc, R_WH0, start = coordinates(7)
    R, joints = free_hand.forward(gc, R_WH0, start)
    for i in range(7):
        one = slice(i, i + 1)
        its_R, its_joints = free_hand.forward(gc[one], R_WH0[one], start[one])
        assert np.array_equal(its_R[0], R[i]) and np.array_equal(its_joints[0], joints[i])


def replaced(old: str, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return change


def joint_changed(name: str, old: str, new: str) -> Callable[[str], str]:
    """Replaces `old` by `new` inside the joint `name`."""

    def change(text: str) -> str:
        start = text.index(f'<joint name="{name}"')
        end = text.index("</joint>", start)
        assert old in text[start:end]
        return text[:start] + text[start:end].replace(old, new, 1) + text[end:]

    return change


BAD = {
    "50 joints": (joint_changed("thumb_distal_rz", 'type="revolute"', 'type="fixed"'), "51 joints"),
    "revolute translation": (joint_changed("wrist_tx", "prismatic", "revolute"), "(wrist_tx) must be prismatic"),
    "wrong axis": (joint_changed("index_proximal_ry", "0 1 0", "0 0 1"), "about axis y"),
    "turned frame": (joint_changed("ring_middle_rx", 'rpy="0 0 0"', 'rpy="0 0 0.3"'), "parallel"),
    "apart": (joint_changed("ring_middle_ry", 'xyz="0 0 0"', 'xyz="0 0.01 0"'), "share its origin"),
    "base apart": (joint_changed("wrist_tx", 'xyz="0 0 0"', 'xyz="0.05 0 0"'), "share its origin with the hand's base"),
    "wrong parent": (joint_changed("middle_proximal_rx", 'link="palm"', 'link="index_distal"'), "must hang on"),
    "no tip": (joint_changed("little_tip_joint", 'link="little_distal"', 'link="palm"'), "little_distal needs one"),
    "not xml": (replaced("</robot>", ""), "not valid XML"),
}


@pytest.mark.parametrize("name", BAD)
def test_other_robots_are_refused_with_the_file_and_the_reason(tmp_path: Path, name: str) -> None:
    change, part = BAD[name]
    path = tmp_path / "hand.urdf"
    path.write_text(change(URDF_PATH.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(DataError) as error:
        load_hand(path, "free", mano=True)
    assert str(error.value).startswith(str(path)) and part in str(error.value)


def test_a_missing_file_is_a_data_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read"):
        load_hand(tmp_path / "absent.urdf", "free")


@pytest.mark.parametrize(
    ("file", "key", "count"),
    [
        ("dexycb_train_labels.pkl", "final_ee", 376),
        ("dexycb_grasptta_train.pkl", "final_wpos", 400),
        ("contact_opt_train.pkl", "final_wpos", 180),
    ],
)
def test_key_points_of_the_release_s_labels(file: str, key: str, count: int) -> None:
    reference = reference_or_skip()
    if not (reference / "labels" / file).is_file():
        pytest.skip(f"the release has no {file}")
    hand = load_hand(reference / "hand" / "mano_mean.urdf", "mano_mean", weight_carried=False, mano=True)
    content = read_joblib_arrays(reference / "labels" / file)
    qpos = np.concatenate([arrays["final_qpos"] for arrays in content.values()]).astype(float)
    expected = np.concatenate([arrays[key] for arrays in content.values()]).reshape(-1, 21, 3)
    assert len(qpos) == count
    # Coordinates relative to a wrist frame at the world's origin are world coordinates.
    _, joints = hand.forward(qpos, np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
    assert np.abs(joints - expected).max() < 1e-9
