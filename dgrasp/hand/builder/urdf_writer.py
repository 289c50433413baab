"""Write a hand's rigid parts as a RaiSim-style URDF with MANO's 51 joints.

From the fixed link `world` three prismatic and three revolute joints lead to the link `palm`; then, finger by
finger, three revolute joints x, y, z per part. A part's link hangs on its z joint and carries the part's collision
shapes and mass. The links are named as in `skeleton.PARTS` and, for the tips, `<finger>_tip`; the joints as in
`skeleton.DOF_NAMES`, in that depth-first order. The order is that of the authors' hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from dgrasp.hand.mano.skeleton import DOF_NAMES, FINGERS, PART_PARENT, PARTS
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape

DAMPING = {"prismatic": "10", "revolute": "1"}
"""Viscous joint damping, N s/m and N m s/rad. It is part of the controlled dynamics of the paper's hand and of ours."""
EFFORT = {"prismatic": "100", "revolute": "1000"}
"""N and N m."""
WRIST_REACH = 2.0
"""m. Limit of the wrist's translations from the place of its base."""
SMALL_MASS, SMALL_INERTIA = 1e-5, 1e-8
"""kg, kg m^2. For the links between a part's joints, if the file is for tools, such as MuJoCo, that refuse links
without mass."""

_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


@dataclass(frozen=True)
class LinkPart:
    """One rigid part for the file. Its frame has its joint as origin and axes parallel to the wrist's at the zero pose.

    offset (3,) m: the frame's origin in the parent part's frame. limits (3, 2) rad: rotations about x, y, z.
    shapes: collision shapes; a hull is written as the name of its file, which must lie beside the URDF. mass kg,
    center (3,) m, inertia (3, 3) kg m^2 about the centre. visual: a mesh beside the URDF, or "" to show the shapes.
    """

    offset: Array
    limits: Array
    shapes: tuple[Shape, ...]
    mass: float
    center: Array
    inertia: Array
    visual: str = ""


def hand_urdf(name: str, comment: str, parts: Sequence[LinkPart], tips: Array, massless: bool) -> str:
    """The text of the URDF of 16 parts, order of `skeleton.PARTS`.

    tips (5, 3) m: fingertips in the distal parts' frames, order of `skeleton.FINGERS`. massless: whether the links
    between joints have no mass, as RaiSim allows, or a very small one, as other tools require.
    """
    robot = ElementTree.Element("robot", name=name)
    material = ElementTree.SubElement(robot, "material", name="skin")
    ElementTree.SubElement(material, "color", rgba="0.85 0.66 0.55 1")
    ElementTree.SubElement(robot, "link", name="world")
    parent = "world"
    for joint in DOF_NAMES[:3]:
        _add_between(robot, f"{joint}_link", massless)
        reach = np.array([-WRIST_REACH, WRIST_REACH])
        _add_joint(robot, joint, "prismatic", parent, f"{joint}_link", np.zeros(3), reach)
        parent = f"{joint}_link"
    for index, (part_name, part) in enumerate(zip(PARTS, parts, strict=True)):
        prefix = "wrist" if index == 0 else part_name
        _add_part(robot, part, part_name, prefix, parent if index == 0 else PARTS[PART_PARENT[index]], massless)
        if part_name.endswith("distal"):
            finger = FINGERS[(index - 1) // 3]
            tip = ElementTree.SubElement(robot, "link", name=f"{finger}_tip")
            _add_inertial(tip, 0.0, np.zeros(3), np.zeros((3, 3)))
            _add_joint(robot, f"{finger}_tip_joint", "fixed", part_name, f"{finger}_tip", tips[(index - 1) // 3])
    ElementTree.indent(robot, space="  ")
    text = ElementTree.tostring(robot, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n<!-- {comment} -->\n{text}\n'


def numbers(*values: float) -> str:
    """Numbers as the file writes them: six decimals."""
    # Rounding keeps the file the same on platforms whose last bits differ; adding 0.0 drops the minus of zero.
    return " ".join(f"{round(float(value), 6) + 0.0:.6g}" for value in values)


def _add_part(
    robot: ElementTree.Element, part: LinkPart, name: str, prefix: str, parent: str, massless: bool
) -> None:
    """The part's three revolute joints, the links between them, and its link."""
    for axis, limit in zip("xyz", part.limits, strict=True):
        child = name if axis == "z" else f"{prefix}_r{axis}_link"
        offset = part.offset if axis == "x" else np.zeros(3)
        if axis == "z":
            link = ElementTree.SubElement(robot, "link", name=child)
            _add_inertial(link, part.mass, part.center, part.inertia)
            if part.visual:
                visual = ElementTree.SubElement(link, "visual")
                _add_mesh(visual, part.visual)
                ElementTree.SubElement(visual, "material", name="skin")
            for tag in ("collision",) if part.visual else ("visual", "collision"):
                for shape in part.shapes:
                    _add_shape(link, tag, shape)
        else:
            _add_between(robot, child, massless)
        _add_joint(robot, f"{prefix}_r{axis}", "revolute", parent, child, offset, limit)
        parent = child


def _add_shape(link: ElementTree.Element, tag: str, shape: Shape) -> None:
    element = ElementTree.SubElement(link, tag)
    if shape.kind == "hull":
        assert shape.file is not None
        _add_mesh(element, shape.file.name)
        return
    ElementTree.SubElement(element, "origin", xyz=numbers(*shape.position), rpy=numbers(*_roll_pitch_yaw(shape)))
    geometry = ElementTree.SubElement(element, "geometry")
    if shape.kind == "box":
        ElementTree.SubElement(geometry, "box", size=numbers(*shape.size))
    else:
        radius, length = shape.size
        ElementTree.SubElement(geometry, "capsule", radius=numbers(radius), length=numbers(length))
    if tag == "visual":
        ElementTree.SubElement(element, "material", name="skin")


def _add_mesh(element: ElementTree.Element, filename: str) -> None:
    ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), "mesh", filename=filename)


def _roll_pitch_yaw(shape: Shape) -> tuple[float, float, float]:
    """URDF's fixed-axis angles of a shape, rad."""
    R = matrix_from_quaternion(np.array(shape.quaternion))
    if shape.kind == "capsule":
        # A capsule may turn about its own axis: without roll there is no gimbal lock for one that lies along x.
        return 0.0, math.acos(max(-1.0, min(1.0, R[2, 2]))), math.atan2(R[1, 2], R[0, 2])
    pitch = math.asin(max(-1.0, min(1.0, -R[2, 0])))
    if abs(R[2, 0]) > 1.0 - 1e-9:
        return 0.0, pitch, math.atan2(-R[0, 1], R[1, 1])
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _add_inertial(link: ElementTree.Element, mass: float, center: Array, inertia: Array) -> None:
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=numbers(*center), rpy="0 0 0")
    # Masses and moments need more digits than lengths: those of a fingertip are about 1e-3 kg and 1e-7 kg m^2.
    ElementTree.SubElement(inertial, "mass", value=numbers(mass))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    values = {key: f"{round(float(inertia[i, j]), 10) + 0.0:.6g}" for key, (i, j) in entries.items()}
    ElementTree.SubElement(inertial, "inertia", values)


def _add_between(robot: ElementTree.Element, name: str, massless: bool) -> None:
    """A link between two joints of one part."""
    mass, inertia = (0.0, 0.0) if massless else (SMALL_MASS, SMALL_INERTIA)
    _add_inertial(ElementTree.SubElement(robot, "link", name=name), mass, np.zeros(3), inertia * np.eye(3))


def _add_joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, offset: Array, limit: Array | None = None
) -> None:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=numbers(*offset), rpy="0 0 0")
    if limit is not None:
        ElementTree.SubElement(joint, "axis", xyz=_AXES[name[-1]])
        lower, upper = numbers(limit[0]), numbers(limit[1])
        ElementTree.SubElement(joint, "limit", lower=lower, upper=upper, effort=EFFORT[kind], velocity="100")
        ElementTree.SubElement(joint, "dynamics", damping=DAMPING[kind], friction="0")
