"""Joints that follow others, as equality constraints of a MuJoCo model."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco as mj

from raisim_like.urdf import UrdfModel


def tie_solref(timestep: float) -> list[float]:
    """A spring and a damper that remove the error of a following joint within one step."""
    return [-1.0 / timestep**2, -1.0 / timestep]


def add_ties(spec: mj.MjSpec, urdf: UrdfModel, joints: Sequence[str], solimp: Sequence[float]) -> None:
    """Tie the following joints of a system to their leaders. joints: names of its joints in the model."""
    for link, name in zip(urdf.links, joints, strict=True):
        if link.mimic is not None:
            tie = spec.add_equality(
                type=mj.mjtEq.mjEQ_JOINT, objtype=mj.mjtObj.mjOBJ_JOINT, name1=name, name2=joints[link.mimic.leader],
                solref=tie_solref(spec.option.timestep), solimp=solimp,
            )  # fmt: skip
            # The coefficients of a polynomial in the leader's coordinate.
            tie.data[:2] = link.mimic.offset, link.mimic.multiplier
