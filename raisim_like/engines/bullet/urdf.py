"""The URDF for PyBullet: collapsed links, each with a mass and an inertia that its solver can handle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from raisim_like.engines.floors import LIGHT_INERTIA, MIN_MASS
from raisim_like.rotations import transform
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfLink, UrdfModel, shape_pose

LINK_INERTIA = 3e-4
"""Inertia of every revolute link, kg m^2. Bullet's contact solver sees the links but not the controller, and it would
not converge with a few grams at the end of a chain. The controller makes up for the difference (`pd`)."""
WRIST_INERTIA = 1e-3
"""Inertia of the links of the wrist's rotations, kg m^2."""
FAR = 1e3
"""Limit of a prismatic joint that should have none, m; PyBullet requires one."""

_BASE = (
    '<link name="base"><inertial><mass value="0"/>'
    '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


def simulated_inertias(model: UrdfModel) -> NDArray[Any]:
    """(dof,) isotropic inertia of each link as simulated, kg m^2."""
    wrist = _wrist_links(model)
    return np.array(
        [
            LIGHT_INERTIA if link.kind == "prismatic" else (WRIST_INERTIA if i in wrist else LINK_INERTIA)
            for i, link in enumerate(model.links)
        ]
    )


def _wrist_links(model: UrdfModel) -> set[int]:
    """Indices of the unbranched chain of links from the base, which moves and turns the root body."""
    chain: set[int] = set()
    current = -1
    while True:
        children = [i for i, link in enumerate(model.links) if link.parent == current]
        if len(children) != 1:
            return chain
        current = children[0]
        chain.add(current)


def normalised_urdf(model: UrdfModel, enforce_limits: bool = True) -> str:
    """URDF text with one link per degree of freedom and Bullet-friendly masses and inertias."""
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(model.name)}>", _BASE]
    inertias = simulated_inertias(model)
    for i, link in enumerate(model.links):
        x, y, z = (float(v) for v in link.com)
        J = float(inertias[i])
        lines.append(f'<link name="link{i}"><inertial><origin xyz="{x!r} {y!r} {z!r}"/>')
        lines.append(f'<mass value="{max(link.mass, MIN_MASS)!r}"/>')
        lines.append(f'<inertia ixx="{J!r}" iyy="{J!r}" izz="{J!r}" ixy="0" ixz="0" iyz="0"/></inertial>')
        for shape in link.shapes:
            body = _geometry(shape)
            lines.append(f"<collision>{body}</collision><visual>{body}</visual>")
        lines.append("</link>")
        parent = "base" if link.parent < 0 else f"link{link.parent}"
        lines.append(
            f"<joint name={quoteattr(link.joint)} type={quoteattr(_kind(link, enforce_limits))}>"
            f'<parent link="{parent}"/><child link="link{i}"/>{_origin(link.origin)}'
            f'<axis xyz="{" ".join(repr(float(v)) for v in link.axis)}"/>'
        )
        lower, upper = link.lower, link.upper
        if link.kind == "prismatic" and not _limited(link, enforce_limits):
            # A prismatic joint needs a limit; this one is never reached.
            lower, upper = -FAR, FAR
        if np.isfinite(lower):
            lines.append(f'<limit lower="{lower!r}" upper="{upper!r}" effort="1000" velocity="100"/>')
        lines.append("</joint>")
    lines.append("</robot>")
    return "\n".join(lines)


def compound_urdf(
    shapes: Sequence[Shape], mass: float, com: NDArray[Any], axes: NDArray[Any], more: Sequence[Shape] = ()
) -> str:
    """URDF text of one rigid body of several shapes; its inertia is set afterwards, along the columns of `axes`.

    more: shapes on a link of their own (link 0), which is massless and does not move against the body.
    """
    inertial = f'<inertial>{_origin(transform(axes, com))}<mass value="{float(mass)!r}"/>'
    lines = ['<?xml version="1.0"?>', '<robot name="compound">', f'<link name="body">{inertial}']
    lines.append('<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>')
    for shape in shapes:
        body = _geometry(shape)
        concave = ' concave="yes"' if shape.kind == "mesh" else ""
        lines.append(f"<collision{concave}>{body}</collision><visual>{body}</visual>")
    lines.append("</link>")
    if more:
        lines.append('<link name="more"><inertial><mass value="0"/>'
                     '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>')
        lines += [f"<collision>{_geometry(shape)}</collision>" for shape in more]
        lines.append('</link><joint name="fixed" type="fixed"><parent link="body"/><child link="more"/></joint>')
    return "\n".join([*lines, "</robot>"])


def _kind(link: UrdfLink, enforce_limits: bool) -> str:
    if link.kind == "prismatic":
        return link.kind
    return "revolute" if _limited(link, enforce_limits) else "continuous"


def _limited(link: UrdfLink, enforce_limits: bool) -> bool:
    """Whether Bullet stops the joint at its limits; a joint that follows another one stops with its leader."""
    return enforce_limits and link.mimic is None and bool(np.isfinite(link.lower))


def _rpy(R: NDArray[Any]) -> tuple[float, float, float]:
    pitch = float(np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        return 0.0, pitch, float(np.arctan2(-R[0, 1], R[1, 1]))
    return float(np.arctan2(R[2, 1], R[2, 2])), pitch, float(np.arctan2(R[1, 0], R[0, 0]))


def _origin(T: NDArray[Any]) -> str:
    xyz = " ".join(repr(float(v)) for v in T[:3, 3])
    rpy = " ".join(repr(v) for v in _rpy(T[:3, :3]))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


def _geometry(shape: Shape) -> str:
    size = [repr(float(v)) for v in shape.size]
    if shape.kind == "box":
        inner = f'<box size="{" ".join(size)}"/>'
    elif shape.kind == "sphere":
        inner = f'<sphere radius="{size[0]}"/>'
    elif shape.kind in ("cylinder", "capsule"):
        inner = f'<{shape.kind} radius="{size[0]}" length="{size[1]}"/>'
    else:
        scale = " ".join(repr(float(v)) for v in shape.scale)
        inner = f'<mesh filename={quoteattr(str(shape.file))} scale="{scale}"/>'
    return f"{_origin(shape_pose(shape))}<geometry>{inner}</geometry>"
