"""A world's bodies as a compiled MuJoCo model with its data, and where each body is in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco as mj
import numpy as np

from raisim_like.batch import Preset
from raisim_like.engines.mujoco.model import Item, ModelMaker, System, solref
from raisim_like.engines.mujoco.ties import tie_solref
from raisim_like.engines.protocol import Array
from raisim_like.errors import EngineError
from raisim_like.material import MaterialTable


@dataclass(frozen=True)
class Slot:
    """Where a body is in MuJoCo's arrays: qpos, qvel, joints, moving bodies, mocap bodies (-1 for a free body)."""

    q: slice
    v: slice
    joints: slice
    bodies: slice
    mocap: int


class BuiltModel:
    """A compiled model with its data, and where each body is in them.

    owner, link: (ngeom,) body id and moving-link index (-1 for none) of each geom. drives: for each articulated system
    its drive and the parts of the model and the data that a step sets from it.
    """

    def __init__(
        self, items: Mapping[int, Item], materials: MaterialTable, timestep: float, gravity: Array, preset: Preset
    ) -> None:
        maker = ModelMaker(items, materials, timestep, gravity, preset)
        try:
            self.model = maker.spec.compile()
        except ValueError as error:
            raise EngineError(f"MuJoCo refused a body: {' '.join(str(error).split())}") from None
        self.data = mj.MjData(self.model)
        owner, link = np.full(self.model.nbody, -1), np.full(self.model.nbody, -1)
        self.slots: dict[int, Slot] = {}
        for body, elements in maker.elements.items():
            ids = [element.id for element in elements]
            self.slots[body] = self._slot(ids)
            owner[ids], link[ids] = body, range(-1, len(ids) - 1)
        self.owner, self.link = owner[self.model.geom_bodyid], link[self.model.geom_bodyid]
        self.drives = [
            (item.drive, self.model.qpos_spring[slot.q], self.data.qfrc_applied[slot.v])
            for item, slot in ((items[body], slot) for body, slot in self.slots.items()) if isinstance(item, System)
        ]
        self.length = timestep
        """Length of an engine step, s."""
        self._scratch: mj.MjData | None = None

    def _slot(self, ids: list[int]) -> Slot:
        m = self.model
        first, stop = ids[0], ids[-1] + 1
        mocap = int(m.body_mocapid[first])
        moving = first + 1 if mocap >= 0 else first
        if moving == stop:
            return Slot(slice(0), slice(0), slice(0), slice(0), mocap)
        joint, v = int(m.body_jntadr[moving]), int(m.body_dofadr[moving])
        q, n = int(m.jnt_qposadr[joint]), stop - moving
        if mocap < 0:
            return Slot(slice(q, q + 7), slice(v, v + 6), slice(joint, joint + 1), slice(moving, stop), mocap)
        return Slot(slice(q, q + n), slice(v, v + n), slice(joint, joint + n), slice(moving, stop), mocap)

    def set_timestep(self, timestep: float) -> None:
        """Change the timestep and everything that depends on it except the gains."""
        m = self.model
        m.opt.timestep = self.length = timestep
        for array in (m.geom_solref, m.jnt_solref, m.pair_solref):
            array[:] = solref(timestep)
        m.eq_solref[:] = tie_solref(timestep)

    def set_gains(self, slot: Slot, item: System) -> None:
        """Set a system's PD control: springs and dampers in the joints, and the armature that makes them implicit."""
        m, dt = self.model, self.model.opt.timestep
        D = item.drive.kd + item.urdf.joint_damping + dt * item.drive.kp
        m.jnt_stiffness[slot.joints] = item.drive.kp
        m.dof_damping[slot.v], m.dof_armature[slot.v] = D, dt * D
        self.derive_constants()

    def derive_constants(self) -> None:
        """Recompute what follows from masses, inertias and armatures; the hardness of contacts is relative to it."""
        # MuJoCo overwrites the data that it is given.
        if self._scratch is None:
            self._scratch = mj.MjData(self.model)
        mj.mj_setConst(self.model, self._scratch)

    def write_forces(self) -> None:
        """Set the forces of the coming step to the feed-forward of each system."""
        for drive, _, applied in self.drives:
            applied[:] = drive.feed_forward
