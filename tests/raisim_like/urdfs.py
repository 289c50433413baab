"""Small URDFs for tests, and the textbook kinematics and mass matrix of any of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dgrasp.types import Array
from raisim_like.engines.floors import MIN_MASS
from raisim_like.rotations import transform
from raisim_like.urdf import UrdfModel


def write_chain(
    path: Path, joints: int = 1, mass: float = 0.3, length: float = 0.2, limit: float = 3.0, damping: float = 0.5,
    tip_radius: float | None = None,
) -> Path:
    """A chain of revolute joints about y whose links reach along x, the mass at each link's far end."""
    ball = ""
    if tip_radius is not None:
        ball = (
            f'<collision><origin xyz="{length} 0 0"/><geometry><sphere radius="{tip_radius}"/></geometry></collision>'
        )
    lines = ['<robot name="chain"><link name="base"/>']
    for i in range(joints):
        lines.append(
            f'<link name="link{i}"><inertial><origin xyz="{length} 0 0"/><mass value="{mass}"/></inertial>{ball}</link>'
            f'<joint name="joint{i}" type="revolute"><parent link="{f"link{i - 1}" if i else "base"}"/>'
            f'<child link="link{i}"/><origin xyz="{length if i else 0} 0 0"/><axis xyz="0 1 0"/>'
            f'<limit lower="{-limit}" upper="{limit}"/><dynamics damping="{damping}"/></joint>'
        )
    path.write_text("".join([*lines, "</robot>"]), encoding="utf-8")
    return path


def turn(axis: Array, angle: float) -> Array:
    """Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def link_poses(model: UrdfModel, q: Array) -> Array:
    """(dof, 4, 4) poses of the moving links in the base frame."""
    poses: list[Array] = []
    for link, angle in zip(model.links, q, strict=True):
        moved = transform(np.eye(3), link.axis * angle) if link.kind == "prismatic" else transform(
            turn(link.axis, angle), np.zeros(3)
        )
        poses.append((np.eye(4) if link.parent < 0 else poses[link.parent]) @ link.origin @ moved)
    return np.array(poses)


def mass_matrix(model: UrdfModel, q: Array, inertias: Array) -> Array:
    """(dof, dof): the sum over links of m Jv^T Jv + J Jw^T Jw, J the isotropic `inertias` (dof,)."""
    poses = link_poses(model, q)
    M = np.zeros((model.dof, model.dof))
    for i, link in enumerate(model.links):
        com = poses[i] @ np.append(link.com, 1.0)
        Jv, Jw = np.zeros((3, model.dof)), np.zeros((3, model.dof))
        k = i
        while k >= 0:
            axis = poses[k][:3, :3] @ model.links[k].axis
            if model.links[k].kind == "prismatic":
                Jv[:, k] = axis
            else:
                Jw[:, k] = axis
                Jv[:, k] = np.cross(axis, com[:3] - poses[k][:3, 3])
            k = model.links[k].parent
        M += max(link.mass, MIN_MASS) * Jv.T @ Jv + inertias[i] * Jw.T @ Jw
    return M
