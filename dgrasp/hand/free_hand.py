"""The free hand as a RaiSim-style URDF: `python -m dgrasp.hand.free_hand [FILE]` writes it, always the same bytes.

From the fixed link `world` three prismatic and three revolute joints lead to the link `palm`; then, finger by
finger, three revolute joints x, y, z per part. A part's link hangs on its z joint and carries the part's collision
shapes and mass; the links between are massless. The links are named as in `skeleton.PARTS` and, for the tips,
`<finger>_tip`; the joints as in `skeleton.DOF_NAMES`, in that depth-first order. The design stands in
`dgrasp.hand.free_anatomy`.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from dgrasp.hand.free_anatomy import HandPart, hand_parts, tip_offsets
from dgrasp.hand.skeleton import DOF_NAMES
from dgrasp.objects.inertia import combine, shape_properties
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape

HAND_NAME = "free"
"""The hand's id in labels (`GraspLabel.hand`)."""

URDF_PATH = Path(__file__).resolve().parents[2] / "data" / "free" / "hand" / "free_hand.urdf"
"""The generated file that ships."""

DENSITY = 1100.0
"""kg/m^3 of every part; overlaps of neighbouring shapes count twice."""

DAMPING = {"prismatic": "10", "revolute": "1"}
"""Viscous joint damping, N s/m and N m s/rad: part of the controlled dynamics of the paper's hand, and of ours."""
EFFORT = {"prismatic": "100", "revolute": "1000"}
"""N and N m."""

WRIST_REACH = 2.0
"""Limit of the wrist's translations from where its base is placed, m."""

_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


def _numbers(*values: float) -> str:
    # Rounding keeps the file the same on platforms whose last bits differ; adding 0.0 drops the minus of zero.
    return " ".join(f"{round(float(value), 6) + 0.0:.6g}" for value in values)


def _roll_pitch_yaw(shape: Shape) -> tuple[float, float, float]:
    """URDF's fixed-axis angles of a shape, rad."""
    R = matrix_from_quaternion(np.array(shape.quaternion))
    if shape.kind == "capsule":
        # A capsule may turn about its own axis: without roll there is no gimbal lock for one that lies along x.
        return 0.0, math.acos(max(-1.0, min(1.0, R[2, 2]))), math.atan2(R[1, 2], R[0, 2])
    return math.atan2(R[2, 1], R[2, 2]), math.asin(max(-1.0, min(1.0, -R[2, 0]))), math.atan2(R[1, 0], R[0, 0])


def _add_shape(link: ElementTree.Element, tag: str, shape: Shape) -> None:
    element = ElementTree.SubElement(link, tag)
    ElementTree.SubElement(
        element, "origin", xyz=_numbers(*shape.position), rpy=_numbers(*_roll_pitch_yaw(shape))
    )
    geometry = ElementTree.SubElement(element, "geometry")
    if shape.kind == "box":
        ElementTree.SubElement(geometry, "box", size=_numbers(*shape.size))
    else:
        radius, length = shape.size
        ElementTree.SubElement(geometry, "capsule", radius=_numbers(radius), length=_numbers(length))
    if tag == "visual":
        ElementTree.SubElement(element, "material", name="skin")


def _add_inertial(link: ElementTree.Element, mass: float, center: Array, inertia: Array) -> None:
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_numbers(*center), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=_numbers(mass))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    # Ten decimals: the smallest moments, of a fingertip, are about 1e-7 kg m^2.
    values = {key: f"{round(float(inertia[i, j]), 10) + 0.0:.6g}" for key, (i, j) in entries.items()}
    ElementTree.SubElement(inertial, "inertia", values)


def _add_massless_link(robot: ElementTree.Element, name: str) -> None:
    _add_inertial(ElementTree.SubElement(robot, "link", name=name), 0.0, np.zeros(3), np.zeros((3, 3)))


def _add_joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, offset: Array, limit: Array | None = None
) -> None:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_numbers(*offset), rpy="0 0 0")
    if limit is not None:
        ElementTree.SubElement(joint, "axis", xyz=_AXES[name[-1]])
        lower, upper = _numbers(limit[0]), _numbers(limit[1])
        ElementTree.SubElement(joint, "limit", lower=lower, upper=upper, effort=EFFORT[kind], velocity="100")
        ElementTree.SubElement(joint, "dynamics", damping=DAMPING[kind], friction="0")


def _add_part(robot: ElementTree.Element, part: HandPart, prefix: str, parent: str) -> None:
    """The part's three revolute joints, the massless links between them, and its link."""
    for axis, limit in zip("xyz", part.limits, strict=True):
        child = part.name if axis == "z" else f"{prefix}_r{axis}_link"
        offset = part.offset if axis == "x" else np.zeros(3)
        if axis == "z":
            link = ElementTree.SubElement(robot, "link", name=child)
            whole = combine(shape_properties(shape) for shape in part.shapes)
            mass = DENSITY * whole.volume
            _add_inertial(link, mass, whole.center_of_mass, whole.inertia_of(mass))
            for tag in ("visual", "collision"):
                for shape in part.shapes:
                    _add_shape(link, tag, shape)
        else:
            _add_massless_link(robot, child)
        _add_joint(robot, f"{prefix}_r{axis}", "revolute", parent, child, offset, limit)
        parent = child


def free_hand_urdf() -> str:
    """The text of the URDF."""
    robot = ElementTree.Element("robot", name="free_hand")
    material = ElementTree.SubElement(robot, "material", name="skin")
    ElementTree.SubElement(material, "color", rgba="0.85 0.66 0.55 1")
    ElementTree.SubElement(robot, "link", name="world")
    parent = "world"
    for name in DOF_NAMES[:3]:
        _add_massless_link(robot, f"{name}_link")
        _add_joint(
            robot, name, "prismatic", parent, f"{name}_link", np.zeros(3), np.array([-WRIST_REACH, WRIST_REACH])
        )
        parent = f"{name}_link"
    tips = tip_offsets()
    for part in hand_parts():
        palm = part.name == "palm"
        _add_part(robot, part, "wrist" if palm else part.name, parent if palm else part.parent)
        if part.name in tips:
            tip, offset = tips[part.name]
            _add_massless_link(robot, tip)
            _add_joint(robot, f"{tip}_joint", "fixed", part.name, tip, offset)
    ElementTree.indent(robot, space="  ")
    command = "python -m dgrasp.hand.free_hand"
    comment = f"<!-- Written by `{command}`; change dgrasp/hand/free_anatomy.py, not this file. -->"
    return f'<?xml version="1.0" encoding="utf-8"?>\n{comment}\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def main(arguments: list[str]) -> None:
    """Write the URDF to the file given, or to where it ships."""
    path = Path(arguments[0]) if arguments else URDF_PATH
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(free_hand_urdf(), encoding="utf-8", newline="\n")
    print(path)


if __name__ == "__main__":
    main(sys.argv[1:])
