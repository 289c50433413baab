"""The URDF reader: what it collapses, where it puts things, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from raisim_like.errors import UrdfError
from raisim_like.urdf import UrdfModel, read_urdf, shape_pose

ARM = """<?xml version="1.1"?>
<robot name="arm">
  <link name="world"/>
  <link name="mount"/>
  <link name="empty"/>
  <link name="arm">
    <inertial><origin xyz="1 0 0"/><mass value="2"/><inertia ixx="0.1" iyy="0.2" izz="0.3" ixy="0.01"/></inertial>
    <collision><origin xyz="0.5 0 0" rpy="0 0 1.5"/><geometry><box size="1 0.2 0.3"/></geometry></collision>
  </link>
  <link name="tool">
    <inertial><origin xyz="0 0 1"/><mass value="6"/><inertia ixx="0" iyy="0" izz="0"/></inertial>
    <collision><geometry><sphere radius="0.1"/></geometry></collision>
    <collision><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision>
    <collision><geometry><capsule radius="0.2" length="0.5"/></geometry></collision>
  </link>
  <link name="mark"/>
  <link name="side"/>
  <joint name="mounting" type="fixed">
    <parent link="world"/><child link="mount"/><origin xyz="0 0 3"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="mount"/><child link="empty"/><origin xyz="1 0 0" rpy="0 0 0.5"/><axis xyz="0 0 2"/>
    <limit lower="-1" upper="2"/>
  </joint>
  <joint name="swing" type="revolute">
    <parent link="empty"/><child link="arm"/><axis xyz="0 1 0"/><limit lower="-0.5" upper="1.5"/>
    <dynamics damping="0.7"/>
  </joint>
  <joint name="grip" type="fixed">
    <parent link="arm"/><child link="tool"/><origin xyz="2 0 0" rpy="0.3 -0.2 0.9"/>
  </joint>
  <joint name="marking" type="fixed"><parent link="tool"/><child link="mark"/><origin xyz="0 0.5 0"/></joint>
  <joint name="spin" type="continuous"><parent link="mount"/><child link="side"/></joint>
</robot>
"""


def read(tmp_path: Path, text: str) -> UrdfModel:
    path = tmp_path / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    return read_urdf(path)


def body(link: str = "", joint: str = "", kind: str = "revolute", extra: str = "") -> str:
    """A robot with one joint; each test puts one mistake into it."""
    return (
        f'<robot name="r"><link name="a"/><link name="b">{link}</link><joint name="j" type="{kind}">'
        f'<parent link="a"/><child link="b"/>{joint}</joint>{extra}</robot>'
    )


@pytest.fixture
def arm(tmp_path: Path) -> UrdfModel:
    return read(tmp_path, ARM)


def test_only_movable_joints_remain_depth_first(arm: UrdfModel) -> None:
    assert arm.name == "arm"
    assert arm.joint_names == ("slide", "swing", "spin")
    assert [link.kind for link in arm.links] == ["prismatic", "revolute", "revolute"]
    assert [link.parent for link in arm.links] == [-1, 0, -1]
    assert arm.joint_limits.tolist() == [[-1, 2], [-0.5, 1.5], [-np.inf, np.inf]]
    assert arm.joint_damping.tolist() == [0, 0.7, 0]


def test_fixed_joints_carry_their_offset_along(arm: UrdfModel) -> None:
    slide = arm.links[0]
    assert slide.origin[:3, 3].tolist() == [1, 0, 3]
    assert np.allclose(slide.origin[:3, :3], Rotation.from_euler("z", 0.5).as_matrix())
    assert slide.axis.tolist() == [0, 0, 1]
    assert arm.links[2].axis.tolist() == [1, 0, 0]


def test_frames_name_every_link_of_the_file(arm: UrdfModel) -> None:
    assert set(arm.frames) == {"world", "mount", "empty", "arm", "tool", "mark", "side"}
    assert arm.frames["mount"][0] == -1 and arm.frames["mount"][1][:3, 3].tolist() == [0, 0, 3]
    index, T = arm.frames["mark"]
    # URDF's roll, pitch, yaw turn about fixed axes, x first.
    R = Rotation.from_euler("xyz", [0.3, -0.2, 0.9]).as_matrix()
    assert index == 1
    assert np.allclose(T[:3, :3], R, atol=1e-15)
    assert np.allclose(T[:3, 3], [2, 0, 0] + R @ [0, 0.5, 0], atol=1e-15)


def test_masses_of_joined_links_add_up(arm: UrdfModel) -> None:
    assert arm.mass == 8.0
    assert arm.links[0].mass == 0.0
    R = Rotation.from_euler("xyz", [0.3, -0.2, 0.9]).as_matrix()
    first, second = np.array([1.0, 0, 0]), np.array([2.0, 0, 0]) + R @ [0, 0, 1]
    com = (2 * first + 6 * second) / 8
    d = second - first
    # Two bodies joined: their own inertias, and the reduced mass at their distance.
    expected = np.array([[0.1, 0.01, 0], [0.01, 0.2, 0], [0, 0, 0.3]]) + 1.5 * (d @ d * np.eye(3) - np.outer(d, d))
    assert np.allclose(arm.links[1].com, com, atol=1e-15)
    assert np.allclose(arm.links[1].inertia, expected, atol=1e-14)


def test_shapes_move_to_the_link_that_carries_them(arm: UrdfModel) -> None:
    box, sphere, cylinder, capsule = arm.links[1].shapes
    assert [s.kind for s in (box, sphere, cylinder, capsule)] == ["box", "sphere", "cylinder", "capsule"]
    assert (box.size, sphere.size, cylinder.size, capsule.size) == ((1, 0.2, 0.3), (0.1,), (0.1, 0.4), (0.2, 0.5))
    assert box.position == (0.5, 0, 0) and sphere.position == (2, 0, 0)
    assert np.allclose(shape_pose(box)[:3, :3], Rotation.from_euler("z", 1.5).as_matrix(), atol=1e-15)
    assert np.allclose(shape_pose(capsule), arm.frames["tool"][1], atol=1e-15)


def test_mesh_files_lie_next_to_the_urdf(tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_text("v 0 0 0\n")
    model = read(tmp_path, body('<collision><geometry><mesh filename="part.obj"/></geometry></collision>'))
    assert model.links[0].shapes[0].file == tmp_path / "part.obj"
    assert model.links[0].shapes[0].kind == "hull"


def collision(geometry: str) -> str:
    return f"<collision><geometry>{geometry}</geometry></collision>"


BAD = {
    "not xml": ("<robot><link></robot>", "not valid XML"),
    "empty": ("", "not valid XML"),
    "declaration alone": ("<?xml version='1.0'", "not valid XML"),
    "doctype": ('<!DOCTYPE robot [<!ENTITY a "b">]><robot name="&a;"/>', "document type"),
    "other root": ("<sdf/>", "<sdf>"),
    "no links": ("<robot/>", "one root link"),
    "parent unknown": (body(extra='<joint name="k" type="fixed"><parent link="z"/><child link="a"/></joint>'), "'k'"),
    "parent missing": (body(extra='<joint name="k" type="fixed"><child link="a"/></joint>'), "'k'"),
    "two parents": (body(extra='<joint name="k" type="fixed"><parent link="a"/><child link="b"/></joint>'),
                    "two parents"),
    "two roots": (body(extra='<link name="c"/>'), "one root link"),
    "loop of all": (body(extra='<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>'),
                    "one root link"),
    "loop apart": (
        body(extra='<link name="c"/><joint name="k" type="fixed"><parent link="c"/><child link="c"/></joint>'),
        "not connected",
    ),
    "name twice": (body(extra='<link name="b"/>'), "used twice"),
    "too deep": ('<robot name="r"><link name="l0"/>' + "".join(
        f'<link name="l{i}"/><joint name="j{i}" type="fixed"><parent link="l{i - 1}"/><child link="l{i}"/></joint>'
        for i in range(1, 1500)) + "</robot>", "too deep"),
    "negative size": (body(collision('<box size="1 -1 1"/>')), "positive"),
    "no size": (body(collision("<box/>")), "expected 3 numbers"),
    "zero radius": (body(collision('<cylinder radius="0" length="1"/>')), "positive"),
    "unknown shape": (body(collision("<cone/>")), "expected box"),
    "no geometry": (body("<collision/>"), "geometry"),
    "mesh missing": (body(collision('<mesh filename="nothing.obj"/>')), "nothing.obj"),
    "joint type": (body(kind="floating"), "'floating'"),
    "joint type missing": (body().replace(' type="revolute"', ""), "expected fixed"),
    "not a number": (body(joint='<origin xyz="0 zero 0"/>'), "'0 zero 0'"),
    "too few numbers": (body(joint='<axis xyz="0 1"/>'), "expected 3 numbers"),
    "nan": (body(joint='<limit lower="nan" upper="1"/>'), "limit"),
    "infinite": (body(joint='<limit lower="0" upper="1e999"/>'), "limit"),
    "limits crossed": (body(joint='<limit lower="1" upper="0"/>'), "above"),
    "axis of no length": (body(joint='<axis xyz="0 0 0"/>'), "no length"),
    "negative mass": (body('<inertial><mass value="-1"/></inertial>'), "negative mass"),
    "mass missing": (body("<inertial/>"), "mass"),
    "negative damping": (body(joint='<dynamics damping="-1"/>'), "negative damping"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_one_error_that_names_the_file(tmp_path: Path, name: str) -> None:
    text, part = BAD[name]
    with pytest.raises(UrdfError) as error:
        read(tmp_path, text)
    message = str(error.value)
    assert message.startswith(str(tmp_path / "robot.urdf")) and part in message and "\n" not in message


def test_bad_scales_are_refused(tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_text("v 0 0 0\n")
    for scale, message in (("2 0 2", "other than zero"), ("2", "expected 3"), ("1 1 nan", "expected 3")):
        with pytest.raises(UrdfError, match=message):
            read(tmp_path, body(collision(f'<mesh filename="part.obj" scale="{scale}"/>')))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    binary = tmp_path / "binary.urdf"
    binary.write_bytes(b"\xff\xfe\x00robot")
    for path in (tmp_path / "absent.urdf", tmp_path, binary):
        with pytest.raises(UrdfError) as error:
            read_urdf(path)
        assert str(error.value).startswith(f"{path}: cannot be read")
