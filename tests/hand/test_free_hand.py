"""The free hand: the file that ships, its layout, its geometry by an independent forward kinematics, its limits."""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from dgrasp.hand.builder.segment import closed_volume
from dgrasp.hand.free.anatomy import BONES, HAND_BREADTH, METACARPAL_BASES, METACARPALS, RADII, knuckles
from dgrasp.hand.free.hand import URDF_PATH, main
from dgrasp.hand.free.skin import free_skin
from dgrasp.hand.mano.skeleton import DOF_NAMES, FINGERS, KEYPOINTS, PARTS, SEGMENTS
from dgrasp.types import Array

# Degrees about x, y, z in which the round ends of thumb and finger meet, other joints at zero.
PINCHES = {
    "index": {
        "index_proximal": (-2, 3, 45),
        "index_middle": (0, 0, 43),
        "index_distal": (0, 0, 26),
        "thumb_proximal": (16, -20, 5),
        "thumb_middle": (2, -10, -2),
        "thumb_distal": (-4, -8, -5),
    },
    "little": {
        "little_proximal": (-10, 5, 50),
        "little_middle": (-2, 2, 41),
        "little_distal": (-1, 2, 23),
        "thumb_proximal": (56, -31, 28),
        "thumb_middle": (10, -19, 3),
        "thumb_distal": (1, -15, -4),
    },
}


def numbers(text: str | None) -> Array:
    return np.array([float(word) for word in (text or "").split()])


@pytest.fixture(scope="module")
def robot() -> ElementTree.Element:
    return ElementTree.parse(URDF_PATH).getroot()


def turn(axis: Array, angle: float) -> Array:
    """Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def link_poses(robot: ElementTree.Element, angles: dict[str, float]) -> dict[str, tuple[Array, Array]]:
    """Rotation and origin of every link in the world, joints in the file's order; parents come before children."""
    poses = {"world": (np.eye(3), np.zeros(3))}
    for joint in robot.findall("joint"):
        R, t = poses[joint.find("parent").get("link")]
        assert numbers(joint.find("origin").get("rpy")).tolist() == [0, 0, 0]
        t = t + R @ numbers(joint.find("origin").get("xyz"))
        if joint.get("type") != "fixed":
            axis, q = numbers(joint.find("axis").get("xyz")), angles.get(joint.get("name"), 0.0)
            if joint.get("type") == "prismatic":
                t = t + R @ axis * q
            else:
                R = R @ turn(axis, q)
        poses[joint.find("child").get("link")] = (R, t)
    return poses


def keypoints(robot: ElementTree.Element, angles: dict[str, float]) -> dict[str, Array]:
    poses = link_poses(robot, angles)
    return {name: poses["palm" if name == "wrist" else name][1] for name in KEYPOINTS}


def degrees(angles: dict[str, float]) -> dict[str, float]:
    return {name: math.radians(value) for name, value in angles.items()}


def limits(robot: ElementTree.Element) -> dict[str, tuple[float, float]]:
    found = {}
    for joint in robot.findall("joint"):
        if (limit := joint.find("limit")) is not None:
            found[joint.get("name")] = (float(limit.get("lower")), float(limit.get("upper")))
    return found


def test_shipped_file_is_what_the_generator_writes(tmp_path: Path) -> None:
    """Words alike, numbers to a tenth of a millimetre: the fit of the shapes ends where rounding lets it."""
    target = tmp_path / "new" / "hand.urdf"
    main([str(target)])
    shipped, made = URDF_PATH.read_text("utf-8"), target.read_text("utf-8")
    number = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
    assert number.sub("#", made) == number.sub("#", shipped)
    pairs = zip(number.findall(made), number.findall(shipped), strict=True)
    assert max(abs(float(a) - float(b)) for a, b in pairs) < 1e-4


def test_joints_have_the_skeletons_names_in_depth_first_order(robot: ElementTree.Element) -> None:
    children: dict[str, list[ElementTree.Element]] = {}
    for joint in robot.findall("joint"):
        children.setdefault(joint.find("parent").get("link"), []).append(joint)

    def walk(link: str) -> list[str]:
        names = []
        for joint in children.get(link, []):
            names += [] if joint.get("type") == "fixed" else [joint.get("name")]
            names += walk(joint.find("child").get("link"))
        return names

    assert tuple(walk("world")) == DOF_NAMES
    in_file = [joint.get("name") for joint in robot.findall("joint") if joint.get("type") != "fixed"]
    assert tuple(in_file) == DOF_NAMES


def test_joint_kinds_axes_and_damping(robot: ElementTree.Element) -> None:
    moving = [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]
    assert [joint.get("type") for joint in moving] == ["prismatic"] * 3 + ["revolute"] * 48
    axes = np.array([numbers(joint.find("axis").get("xyz")) for joint in moving])
    assert np.array_equal(axes, np.tile(np.eye(3), (17, 1)))
    damping = [float(joint.find("dynamics").get("damping")) for joint in moving]
    assert damping == [10.0] * 3 + [1.0] * 48
    fixed = [joint.find("child").get("link") for joint in robot.findall("joint") if joint.get("type") == "fixed"]
    assert fixed == [f"{finger}_tip" for finger in FINGERS]


def test_only_parts_have_mass_and_collision(robot: ElementTree.Element) -> None:
    masses, with_shapes = {}, []
    for link in robot.findall("link"):
        mass = link.find("inertial/mass")
        masses[link.get("name")] = 0.0 if mass is None else float(mass.get("value"))
        if link.findall("collision"):
            with_shapes.append(link.get("name"))
    assert [name for name, mass in masses.items() if mass > 0] == list(PARTS) == with_shapes
    # The parts make up the skin with its wrist closed.
    skin = free_skin()
    assert sum(masses.values()) == pytest.approx(1100 * closed_volume(skin.template, skin.faces), rel=1e-4)


def test_every_inertia_is_that_of_a_real_body(robot: ElementTree.Element) -> None:
    for link in robot.findall("link"):
        if link.get("name") not in PARTS:
            continue
        a = {key: float(value) for key, value in link.find("inertial/inertia").attrib.items()}
        matrix = np.array(
            [[a["ixx"], a["ixy"], a["ixz"]], [a["ixy"], a["iyy"], a["iyz"]], [a["ixz"], a["iyz"], a["izz"]]]
        )
        low, middle, high = np.linalg.eigvalsh(matrix)
        assert low > 1e-8, link.get("name")
        assert high < low + middle + 1e-9, link.get("name")


def test_straight_fingers_have_the_bones_lengths(robot: ElementTree.Element) -> None:
    points = keypoints(robot, {})
    for finger in FINGERS:
        chain = np.array([points[f"{finger}_{joint}"] for joint in (*SEGMENTS, "tip")])
        steps = np.diff(chain, axis=0)
        assert np.linalg.norm(steps, axis=1) == pytest.approx(BONES[finger], abs=2e-6)
        directions = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        assert np.ptp(directions, axis=0).max() < 1e-4


def test_bone_lengths_stay_when_the_joints_bend(robot: ElementTree.Element) -> None:
    rng = np.random.default_rng(3)
    points = keypoints(robot, {name: rng.uniform(-0.7, 0.7) for name in DOF_NAMES})
    for finger in FINGERS:
        chain = np.array([points[f"{finger}_{joint}"] for joint in (*SEGMENTS, "tip")])
        assert np.linalg.norm(np.diff(chain, axis=0), axis=1) == pytest.approx(BONES[finger], abs=2e-6)


def test_knuckles_end_the_metacarpals_and_share_the_breadth() -> None:
    places = knuckles()
    for finger, length in METACARPALS.items():
        x, z = METACARPAL_BASES[finger]
        base = np.array([-0.75 * 0.54 * 0.0646 + x, 0.0, z])
        assert np.linalg.norm(places[finger] - base) == pytest.approx(length, abs=1e-12)
    # Between the outer knuckles lies the breadth less half a share on either side: radii 9.5, 9.5, 9.0, 8.0 mm.
    share = HAND_BREADTH / 36.0
    assert places["index"][2] - places["little"][2] == pytest.approx(HAND_BREADTH - share * (9.5 + 8.0) / 2, abs=1e-12)


def test_it_is_a_right_hand_in_the_papers_wrist_frame(robot: ElementTree.Element) -> None:
    points = keypoints(robot, {})
    fingers = points["middle_tip"] - points["wrist"]
    assert fingers[0] < -0.15 and np.abs(fingers[1:]).max() < 0.01
    order = [points[f"{finger}_tip"][2] for finger in ("thumb", "index", "middle", "ring", "little")]
    assert order == sorted(order, reverse=True)
    # Fingers x palm normal points to the thumb on a right hand, away from it on a left one.
    assert np.cross(fingers, [0.0, -1.0, 0.0]) @ (points["thumb_tip"] - points["wrist"]) > 0


@pytest.mark.parametrize("part", [part for part in PARTS[1:] if not part.startswith("thumb")])
def test_positive_z_flexes_and_positive_y_moves_to_the_thumbs_side(robot: ElementTree.Element, part: str) -> None:
    tip = f"{part.split('_')[0]}_tip"
    rest = keypoints(robot, {})[tip]
    assert keypoints(robot, {f"{part}_rz": 0.3})[tip][1] < rest[1] - 0.004
    assert keypoints(robot, {f"{part}_ry": 0.3})[tip][2] > rest[2] + 0.004


def test_wrist_joints_are_a_translation_then_intrinsic_xyz(robot: ElementTree.Element) -> None:
    angles = {"wrist_tx": 0.1, "wrist_ty": -0.2, "wrist_tz": 0.3, "wrist_rx": 0.4, "wrist_ry": -0.5, "wrist_rz": 0.6}
    R, t = link_poses(robot, angles)["palm"]
    X, Y, Z = np.eye(3)
    assert t == pytest.approx([0.1, -0.2, 0.3])
    assert turn(X, 0.4) @ turn(Y, -0.5) @ turn(Z, 0.6) == pytest.approx(R)


def test_collision_capsules_lie_along_the_bones_and_end_in_the_tips_skin(robot: ElementTree.Element) -> None:
    points = keypoints(robot, {})
    for finger in FINGERS:
        for segment, after in zip(SEGMENTS, (*SEGMENTS[1:], "tip"), strict=True):
            link = robot.find(f"link[@name='{finger}_{segment}']")
            origin, capsule = link.find("collision/origin"), link.find("collision/geometry/capsule")
            roll, pitch, yaw = numbers(origin.get("rpy"))
            axis = turn(np.array([0.0, 0, 1]), yaw) @ turn(np.array([0.0, 1, 0]), pitch) @ np.array([0.0, 0, 1])
            bone = points[f"{finger}_{after}"] - points[f"{finger}_{segment}"]
            along, length = bone / np.linalg.norm(bone), np.linalg.norm(bone)
            assert roll == 0.0
            if (finger, segment) == ("thumb", "proximal"):
                continue  # what moves with its metacarpal is a piece of the ball of the thumb
            assert abs(axis @ along) > math.cos(math.radians(15))
            middle, radius = numbers(origin.get("xyz")), float(capsule.get("radius"))
            assert np.linalg.norm(np.cross(middle, along)) < radius / 2 and 0 < middle @ along < length
            if segment == "distal":
                reach = middle @ along + float(capsule.get("length")) / 2 + radius
                assert reach == pytest.approx(length, abs=3e-3)


def test_limits_hold_the_flat_hand_and_the_fingers_flexion(robot: ElementTree.Element) -> None:
    found = limits(robot)
    assert tuple(found) == DOF_NAMES
    assert all(lower < 0 < upper for lower, upper in found.values())
    for finger in FINGERS[:4]:
        # Norms of 90, 100 and 80 degrees, each with ten degrees of slack.
        for segment, flexion in zip(SEGMENTS, (100, 110, 90), strict=True):
            assert found[f"{finger}_{segment}_rz"][1] == pytest.approx(math.radians(flexion), abs=1e-5)
    for axis in "xyz":
        low, high = found[f"thumb_proximal_r{axis}"]
        assert high - low > math.radians(90)


@pytest.mark.parametrize("finger", PINCHES)
def test_thumb_opposes_the_finger_within_the_limits(robot: ElementTree.Element, finger: str) -> None:
    pose = {f"{part}_r{axis}": v for part, xyz in PINCHES[finger].items() for axis, v in zip("xyz", xyz, strict=True)}
    angles, found = degrees(pose), limits(robot)
    assert all(found[name][0] <= value <= found[name][1] for name, value in angles.items())
    poses = link_poses(robot, angles)
    centers, radii = [], []
    for digit in (finger, "thumb"):
        tip, joint = poses[f"{digit}_tip"][1], poses[f"{digit}_distal"][1]
        radii.append(RADII[digit][2])
        centers.append(tip - (tip - joint) / np.linalg.norm(tip - joint) * radii[-1])
    # The round ends of the two last capsules touch.
    assert np.linalg.norm(centers[0] - centers[1]) == pytest.approx(sum(radii), abs=2e-3)
    assert centers[0][1] < -0.03


def test_a_fist_closes_on_the_palms_side(robot: ElementTree.Element) -> None:
    flexed = {f"{f}_{s}_rz": angle for f in FINGERS[:4] for s, angle in zip(SEGMENTS, (80, 95, 60), strict=True)}
    points = keypoints(robot, degrees(flexed))
    for finger in FINGERS[:4]:
        tip = points[f"{finger}_tip"]
        assert tip[1] < -0.010 and points[f"{finger}_proximal"][0] < tip[0] < -0.02
