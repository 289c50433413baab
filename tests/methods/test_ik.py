from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dgrasp.env.goal import make_goal
from dgrasp.geometry.intersection import Body, body
from dgrasp.hand.mano.skeleton import KEYPOINTS, PARTS
from dgrasp.methods import METHODS, IkBaseline
from dgrasp.methods.ik import closest_points, contact_keypoints, correct_labels
from dgrasp.types import GraspLabel
from raisim_like.rotations import matrix_from_euler, transform
from tests.geometry.solids import box
from tests.scenes import free_hand, make_label

SIZE = (0.06, 0.08, 0.10)
NAME = "004_sugar_box"


@pytest.fixture(scope="module")
def objects() -> dict[str, Body]:
    return {NAME: body([box(SIZE)])}


def label_at(depth: float, index: int = 0) -> GraspLabel:
    """A grasp whose index fingertip is `depth` m inside the face x = 3 cm of a tilted box."""
    label = make_label(free_hand(), NAME, index)
    contacts = np.zeros(16, bool)
    contacts[PARTS.index("index_distal")] = True
    R = matrix_from_euler(np.array([0.3, -0.5, 0.8]))
    tip = label.joints_W[KEYPOINTS.index("index_tip")]
    T_WO = transform(R, tip - R @ np.array([SIZE[0] / 2 - depth, 0.004, 0.002]))
    return dataclasses.replace(label, T_WO=T_WO, goal_contacts=contacts)


def test_it_is_a_baseline_of_its_name() -> None:
    assert METHODS["gt_ik"] is IkBaseline and IkBaseline.mode == "label"
    assert not IkBaseline().act(np.zeros((2, 279))).any()


def test_key_points_of_contacts() -> None:
    goal, distance = np.zeros((1, 16), bool), np.full((1, 21), 0.05)
    keypoint_parts = free_hand().chain.keypoint_parts
    names = {name: i for i, name in enumerate(KEYPOINTS)}

    def chosen(*parts: str, **near: float) -> set[str]:
        goal[:], distance[:] = False, 0.05
        goal[0, [PARTS.index(part) for part in parts]] = True
        for name, d in near.items():
            distance[0, names[name]] = d
        return {KEYPOINTS[k] for k in np.flatnonzero(contact_keypoints(keypoint_parts, goal, distance)[0])}

    assert chosen() == set() and chosen("palm") == set()
    assert chosen("index_middle") == {"index_middle"}
    assert chosen("thumb_distal", thumb_tip=0.01) == {"thumb_tip"}
    assert chosen("thumb_distal", thumb_tip=0.01, thumb_distal=0.014) == {"thumb_tip", "thumb_distal"}
    # If none is within 15 mm, the closer one is chosen.
    assert chosen("ring_distal", ring_tip=0.03, ring_distal=0.02) == {"ring_distal"}
    # A key point that is near but belongs to no goal contact is not chosen.
    assert chosen("index_middle", little_tip=0.001) == {"index_middle"}


@pytest.mark.parametrize("depth", [0.006, -0.006])
def test_a_fingertip_inside_or_outside_comes_to_the_surface(objects: dict[str, Body], depth: float) -> None:
    before = label_at(depth)
    tip = KEYPOINTS.index("index_tip")
    place = make_goal([before]).joints_O
    assert place[0, tip] == pytest.approx([0.03 - depth, 0.004, 0.002])
    closest = closest_points([before], place, objects)
    assert closest[0, tip] == pytest.approx([0.03, 0.004, 0.002], abs=2e-3)
    (after,) = correct_labels([before], free_hand(), objects)
    x = make_goal([after]).joints_O[0]
    assert abs(x[tip, 0] - 0.03) < 0.5 * abs(depth)
    others = [i for i in range(21) if not KEYPOINTS[i].startswith("index")]
    assert np.abs(x[others] - place[0, others]).max() < 2e-3
    # Pose, wrist and key points agree with each other; the label's other fields do not change.
    gc = np.zeros((1, 51))
    gc[0, 6:] = after.hand_pose
    _, joints = free_hand().forward(gc, after.T_WH[None, :3, :3], after.T_WH[None, :3, 3])
    assert joints[0] == pytest.approx(after.joints_W, abs=1e-9)
    assert (after.T_WO == before.T_WO).all() and after.name == before.name and after.start is before.start


def test_the_place_of_the_scene_does_not_matter(objects: dict[str, Body]) -> None:
    label = label_at(0.006)
    T = transform(matrix_from_euler(np.array([0.0, 0.0, 1.2])), np.array([0.3, -0.8, 0.1]))
    elsewhere = dataclasses.replace(
        label, T_WH=T @ label.T_WH, T_WO=T @ label.T_WO, joints_W=label.joints_W @ T[:3, :3].T + T[:3, 3]
    )
    one, two = correct_labels([label, elsewhere], free_hand(), objects)
    assert two.hand_pose == pytest.approx(one.hand_pose, abs=1e-6)
    assert np.abs(two.T_WH - T @ one.T_WH).max() < 1e-6


def test_labels_without_contacts_stay(objects: dict[str, Body]) -> None:
    label = dataclasses.replace(label_at(0.006), goal_contacts=np.zeros(16, bool))
    (same,) = correct_labels([label], free_hand(), objects)
    assert same.hand_pose == pytest.approx(label.hand_pose, abs=1e-9)
