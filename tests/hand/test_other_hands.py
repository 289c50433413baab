"""Hands that are no human ones: what is read from a URDF, and its kinematics against the chain of joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.env.registry import ENVS
from dgrasp.errors import DataError
from dgrasp.hand.inverse import fit_keypoints
from dgrasp.hand.kinematics import Kinematics
from dgrasp.hand.load import load_hand
from dgrasp.hand.model import HandModel
from dgrasp.hand.motions import hand_motions
from dgrasp.types import Array
from raisim_like.rotations import transform
from tests.hand.three_fingers import write_three_fingers
from tests.raisim_like.urdfs import link_poses
from tests.scenes import free_hand


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> HandModel:
    return load_hand(write_three_fingers(tmp_path_factory.mktemp("hand") / "three.urdf"), "three", side=None)


def test_names_and_indices_come_from_the_file(three: HandModel) -> None:
    layout = three.layout
    assert layout.names.joints == ("long_0_joint", "long_1_joint", "long_2_joint", "short_0_joint", "short_1_joint",
                                   "thumb_0_joint")  # fmt: skip
    assert layout.names.parts == ("palm", "long_0", "long_1", "long_2", "short_0", "short_1", "thumb_0")
    assert layout.names.keypoints == ("wrist", "long_0", "long_1", "long_2", "long_tip", "short_0", "short_1",
                                      "short_tip", "thumb_0", "thumb_0_tip")  # fmt: skip
    assert (layout.n_dof, layout.n_joints, layout.n_parts, layout.n_keypoints) == (12, 6, 7, 10)
    assert [finger.joints for finger in layout.fingers] == [(0, 1, 2), (3, 4), (5,)]
    assert [finger.parts for finger in layout.fingers] == [(1, 2, 3), (4, 5), (6,)]
    assert layout.thumb == 2 and layout.tips == (4, 7, 9) and layout.finger_of_part == (-1, 0, 0, 0, 1, 1, 2)
    assert {task: kind.actions(layout) for task, kind in ENVS.items()} == {"grasp": 12, "flat": 12, "motion": 6}
    assert three.rest.tolist() == [0.0] * 6 and three.carried_mass == pytest.approx(three.urdf.mass)
    # Without a link that marks it, the tip is the farthest point of the thumb's capsule.
    assert three.tips[2] == pytest.approx([0.0, -0.079, 0.0], abs=1e-3)


def test_forward_kinematics_are_those_of_the_chain(three: HandModel) -> None:
    rng = np.random.default_rng(1)
    gc, R0, start = rng.uniform(-1, 1, (5, 12)), Rotation.random(5, random_state=2).as_matrix(), rng.normal(size=(5, 3))
    R_WH, points = three.forward(gc, R0, start)
    for i in range(5):
        poses = transform(R0[i], start[i]) @ link_poses(three.urdf, gc[i])
        assert np.abs(R_WH[i] - poses[5][:3, :3]).max() < 1e-12
        for k, (part, offset) in enumerate(zip(three.chain.keypoint_parts, three.chain.keypoint_offsets, strict=True)):
            T = poses[three.part_links[part]]
            assert np.abs(points[i, k] - (T[:3, :3] @ offset + T[:3, 3])).max() < 1e-12


def test_two_joints_of_one_part_turn_it_one_after_the_other() -> None:
    """A part with joints about y and then z, in frames turned against each other, by hand."""
    quarter = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    chain = Kinematics(
        np.array([-1, 0]), np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), np.array([1, 1]),
        np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.array([np.eye(3), quarter]), np.array([0, 1, 1]),
        np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.05, 0.0, 0.0]]),
    )  # fmt: skip
    pose = np.array([[0.3, -0.7]])
    R, t = chain.part_frames(np.eye(3)[None], np.zeros((1, 3)), pose)
    expected = Rotation.from_euler("y", 0.3).as_matrix() @ quarter @ Rotation.from_euler("z", -0.7).as_matrix()
    assert R[0, 1] == pytest.approx(expected, abs=1e-12)
    assert chain.keypoints(R, t)[0, 2] == pytest.approx(np.array([0.1, 0, 0]) + expected @ [0.05, 0, 0], abs=1e-12)
    axes = chain.joint_axes(R, pose)[0]
    assert axes[0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert axes[1] == pytest.approx(Rotation.from_euler("y", 0.3).as_matrix() @ quarter @ [0, 0, 1], abs=1e-12)
    assert chain.beyond[1].tolist() == [2]


@pytest.mark.parametrize("name", ["three", "free"])
def test_axes_are_what_key_points_turn_about(three: HandModel, name: str) -> None:
    """Against differences: moving one joint a little moves what is beyond it about its axis."""
    hand = three if name == "three" else free_hand()
    rng, chain = np.random.default_rng(3), hand.chain
    pose = rng.uniform(-0.8, 0.8, (1, hand.layout.n_joints))

    def points(angles: Array) -> tuple[Array, Array, Array]:
        R, t = chain.part_frames(np.eye(3)[None], np.zeros((1, 3)), angles)
        return R, t, chain.keypoints(R, t)[0]

    R, t, here = points(pose)
    axes = chain.joint_axes(R, pose)[0]
    for joint in range(hand.layout.n_joints):
        step = np.zeros_like(pose)
        step[0, joint] = 1e-6
        moved = (points(pose + step)[2] - points(pose - step)[2]) / 2e-6
        part = int(chain.joint_parts[joint])
        expected = np.zeros_like(here)
        expected[chain.beyond[part]] = np.cross(axes[joint], here[chain.beyond[part]] - t[0, part])
        assert moved == pytest.approx(expected, abs=1e-8)


def test_inverse_kinematics_find_the_pose_of_key_points(three: HandModel) -> None:
    rng = np.random.default_rng(4)
    pose = rng.uniform(*three.limits[6:].T, (3, 6))
    T = transform(Rotation.random(3, random_state=5).as_matrix(), rng.normal(size=(3, 3)))
    targets = three.keypoints_at(T, pose)
    begin = T.copy()
    begin[:, :3, 3] += 0.01
    fit = fit_keypoints(three, begin, np.clip(pose + 0.1, *three.limits[6:].T), targets)
    assert np.linalg.norm(fit.joints - targets, axis=2).max() < 0.002


def test_motions_close_the_joints_and_pads_face_what_is_held(three: HandModel) -> None:
    motions = hand_motions(three)
    assert motions.to_pose.shape == (6, 6) and motions.flexions.all() and motions.thumb == 2
    assert motions.thumb_side == 0.0
    pose = motions.mean @ motions.to_pose
    assert (pose > 0.0).all() and (pose < three.limits[6:, 1]).all()
    # Fingers along -x close towards -y; the thumb, along -y, towards -x.
    assert motions.palmar[1:6] == pytest.approx(np.tile([0.0, -1.0, 0.0], (5, 1)), abs=1e-6)
    assert motions.palmar[6] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-6)


def test_without_a_thumb_the_finger_that_stands_apart_opposes(three: HandModel) -> None:
    nameless = dataclasses.replace(three, layout=dataclasses.replace(three.layout, thumb=None))
    assert hand_motions(nameless).thumb == 2


def test_the_free_hand_has_manos_names_and_its_arm_carries_it() -> None:
    hand = free_hand()
    assert hand.layout.n_dof == 51 and hand.layout.thumb == 4 and hand.layout.side == "right"
    assert [finger.name for finger in hand.layout.fingers] == ["index", "middle", "ring", "little", "thumb"]
    assert hand.carried_mass == pytest.approx(hand.urdf.mass)
    assert load_hand(hand.urdf.path, "x", weight_carried=False).carried_mass == 0.0


BAD: dict[str, tuple[Callable[[str], str], str]] = {
    "no fingers": (lambda t: t.replace('type="revolute"><parent link="palm"', 'type="fixed"><parent link="palm"')
                   .replace("_joint\" type=\"revolute\"", "_joint\" type=\"fixed\""), "at least one finger joint"),
    "sliding finger": (lambda t: t.replace('"long_1_joint" type="revolute"', '"long_1_joint" type="prismatic"'),
                       "joint long_1_joint is prismatic"),
    "finger on the wrist": (lambda t: t.replace('<parent link="palm"/><child link="thumb_0"/>',
                                                '<parent link="wrist_rx_link"/><child link="thumb_0"/>'),
                            "hangs on a link of the wrist"),
    "wrist follows": (lambda t: t.replace('<child link="long_1"/>', '<child link="long_1"/><mimic joint="wrist_rx"/>'),
                      "joint long_1_joint has a <mimic> with a joint of the wrist"),
    "wrist turned": (lambda t: t.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>', 1), "about axis y"),
    "MANO's alone": (lambda t: t, "a hand has 51 joints"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_hand_is_refused(tmp_path: Path, name: str) -> None:
    change, part = BAD[name]
    path = write_three_fingers(tmp_path / "bad.urdf")
    path.write_text(change(path.read_text("utf-8")), encoding="utf-8")
    with pytest.raises(DataError) as error:
        load_hand(path, "bad", mano=name == "MANO's alone")
    assert str(error.value).startswith(str(path)) and part in str(error.value)
