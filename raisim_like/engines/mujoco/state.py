"""Read, write, carry over and save the states of compiled MuJoCo models."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco as mj
import numpy as np

from raisim_like.engines.mujoco.built import BuiltModel, Slot
from raisim_like.engines.mujoco.model import Drive
from raisim_like.engines.pending import Pending
from raisim_like.engines.protocol import Array


def write_body(data: mj.MjData, slot: Slot, state: Array) -> None:
    """Set a rigid body's inertial frame to a (13,) state; a static body has no velocity."""
    if slot.mocap >= 0:
        data.mocap_pos[slot.mocap], data.mocap_quat[slot.mocap] = state[:3], state[3:7]
        return
    data.qpos[slot.q] = state[:7]
    # A free joint's angular velocity is in the body's axes.
    back, local = state[3:7] * [1.0, -1.0, -1.0, -1.0], np.zeros(3)
    mj.mju_rotVecQuat(local, state[10:], back / np.linalg.norm(back))
    data.qvel[slot.v] = np.concatenate([state[7:10], local])


def read_body(data: mj.MjData, slot: Slot, out: Array) -> None:
    """Write the (13,) state of a rigid body's inertial frame into out."""
    if slot.mocap >= 0:
        out[:3], out[3:7], out[7:] = data.mocap_pos[slot.mocap], data.mocap_quat[slot.mocap], 0.0
        return
    velocity = data.qvel[slot.v]
    out[:7], out[7:10] = data.qpos[slot.q], velocity[:3]
    mj.mju_rotVecQuat(out[10:], velocity[3:], out[3:7])


def carry_over(old: BuiltModel, new: BuiltModel) -> None:
    """Copy the states of the bodies that both models have from the old model to the new one."""
    for body, slot in new.slots.items():
        was = old.slots.get(body)
        if was is None:
            continue
        new.data.qpos[slot.q], new.data.qvel[slot.v] = old.data.qpos[was.q], old.data.qvel[was.v]
        if slot.mocap >= 0:
            new.data.mocap_pos[slot.mocap] = old.data.mocap_pos[was.mocap]
            new.data.mocap_quat[slot.mocap] = old.data.mocap_quat[was.mocap]


def forget_contacts(built: BuiltModel) -> None:
    """Drop everything except the state: contacts, and the solution from which the solver would start."""
    data = built.data
    state = [part.copy() for part in (data.qpos, data.qvel, data.mocap_pos, data.mocap_quat)]
    mj.mj_resetData(built.model, data)
    data.qpos[:], data.qvel[:], data.mocap_pos[:], data.mocap_quat[:] = state


def begin_pending(built: BuiltModel, pending: Pending, share: float) -> None:
    """Add the pending forces to the data. share: timestep / length of the coming step, which scales them."""
    for body, wrench in pending.wrenches.items():
        built.data.xfrc_applied[built.slots[body].bodies] = share * wrench.ravel()
    for body, extra in pending.generalized.items():
        built.data.qfrc_applied[built.slots[body].v] += share * extra


def end_pending(built: BuiltModel) -> None:
    """Leave only the feed-forward of each system in the data."""
    built.data.xfrc_applied[:] = 0.0
    built.write_forces()


@dataclass
class MujocoSnapshot:
    """The data of a compiled model, the drives of its systems, and the pending forces."""

    built: BuiltModel
    data: mj.MjData
    drives: dict[int, Drive]
    pending: Pending

    @classmethod
    def of(cls, built: BuiltModel, drives: dict[int, Drive], pending: Pending) -> MujocoSnapshot:
        """A snapshot that shares only the model with the world."""
        return cls(built, copy.copy(built.data), copy.deepcopy(drives), pending.copy())
