"""Motion of the links of an articulated system, from the link poses that an engine reports.

Everywhere: R (dof, 3, 3) and t (dof, 3) are the moving links' poses in the world, gv (dof,) the generalised velocity.
A joint's axis passes through the origin of its link.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raisim_like.urdf import UrdfModel

Array = NDArray[Any]


def joint_axes(model: UrdfModel, R: Array) -> Array:
    """(dof, 3) unit axes of the joints, world."""
    axes = np.array([link.axis for link in model.links])
    return np.matmul(R, axes[:, :, None])[..., 0]


def jacobian(model: UrdfModel, R: Array, t: Array, link: int, point_W: Array) -> tuple[Array, Array]:
    """Jacobians (3, dof) of the velocity of a point on a link and of the link's angular velocity, world."""
    linear, angular = np.zeros((3, model.dof)), np.zeros((3, model.dof))
    axes = joint_axes(model, R)
    i = link
    while i >= 0:
        if model.links[i].kind == "prismatic":
            linear[:, i] = axes[i]
        else:
            angular[:, i] = axes[i]
            linear[:, i] = np.cross(axes[i], point_W - t[i])
        i = model.links[i].parent
    return linear, angular


def link_velocities(model: UrdfModel, R: Array, t: Array, gv: Array) -> tuple[Array, Array]:
    """(dof, 3) each: velocities of the links' origins and their angular velocities, world."""
    linear, angular = np.zeros((model.dof, 3)), np.zeros((model.dof, 3))
    along = joint_axes(model, R) * gv[:, None]
    for i, link in enumerate(model.links):
        k = link.parent
        if k >= 0:
            angular[i] = angular[k]
            linear[i] = linear[k] + np.cross(angular[k], t[i] - t[k])
        if link.kind == "prismatic":
            linear[i] += along[i]
        else:
            angular[i] += along[i]
    return linear, angular
