"""Worlds with equal models, advanced together on the device."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco as mj
import mujoco_warp as mjw
import numpy as np
import warp as wp

from raisim_like.batch import Array, BatchState, WorldSpec
from raisim_like.engines.mujoco.built import BuiltModel
from raisim_like.engines.mujoco.model import Solid, System
from raisim_like.engines.mujoco_warp import kernels
from raisim_like.engines.mujoco_warp.device import device
from raisim_like.engines.mujoco_warp.parts import BATCHED, Constants, items_of
from raisim_like.engines.protocol import engine_steps
from raisim_like.errors import EngineError
from raisim_like.rotations import matrix_from_quaternion, rotate, rotate_back

CONTACTS = 64
"""Contacts per world for which there is room at first. The room grows when it does not suffice."""
MOST_CONTACTS = 64 * CONTACTS
APART = 100.0
"""m between the bodies of a world that is not in use: it has no contacts."""
TIMED = ("geom_solref", "jnt_solref", "pair_solref", "eq_solref")
"""Arrays of the model that depend on the length of a step."""
_KINDS = mjw.OverflowType
_FULL = int(_KINDS.NEFC | _KINDS.NJMAX_NNZ | _KINDS.BROADPHASE | _KINDS.NARROWPHASE | _KINDS.CCD)
"""Reports of MuJoCo Warp that contacts or their rows did not fit."""


class Group:
    """N worlds on one model. Rows are numbers of worlds in this group.

    What is set is kept on the host, in single precision, and goes to the device before the next step.
    """

    def __init__(self, specs: Sequence[WorldSpec]) -> None:
        self.spec, n = specs[0], len(specs)
        spec, items = self.spec, items_of(self.spec)
        self.built = BuiltModel(items, spec.materials, spec.timestep, np.array(spec.gravity), spec.preset)
        model = self.built.model
        # MuJoCo Warp does not know this option. It has no reset of its own either, so a broken world stays broken.
        model.opt.disableflags &= ~int(mj.mjtDisableBit.mjDSBL_AUTORESET)
        # MuJoCo takes smaller coefficients for this one; MuJoCo Warp does so too, but warns.
        for friction in (model.geom_friction, model.pair_friction):
            np.maximum(friction, mj.mjMINMU, out=friction)
        self.constants = Constants(self.built, items, specs)
        self.systems = [self.built.slots[body] for body, item in items.items() if isinstance(item, System)]
        solids = [(item, self.built.slots[body]) for body, item in items.items() if isinstance(item, Solid)]
        self.frames, self.bodies = [item.frame for item, _ in solids], [slot for _, slot in solids]
        self.q = np.concatenate([np.zeros(0, int), *(np.r_[slot.q] for slot in self.systems)])
        self.v = np.concatenate([np.zeros(0, int), *(np.r_[slot.v] for slot in self.systems)])

        self.qpos, self.qvel = np.zeros((n, model.nq), np.float32), np.zeros((n, model.nv), np.float32)
        self.springs = np.zeros((n, model.nq), np.float32)
        self.force = np.zeros((n, model.nv), np.float32)
        self.mocap_pos = np.zeros((n, model.nmocap, 3), np.float32)
        self.mocap_quat = np.zeros((n, model.nmocap, 4), np.float32)
        self.kp, self.kd = np.zeros((2, n, spec.dof))
        self.values = [np.zeros((n, *getattr(model, name).shape), np.float32) for name in BATCHED]
        self.fresh, self.other_gains = np.ones(n, np.int32), np.ones(n, bool)
        self.on_links = np.zeros((n, spec.dof, len(self.bodies)))
        self.between = np.zeros((n, len(self.bodies), len(self.bodies)))
        self.park(np.arange(n))
        self._make(n, CONTACTS)

    def _make(self, n: int, contacts: int) -> None:
        """Put the model on the device, and data for n worlds with room for some contacts in each."""
        self.device, model, self.contacts = device(), self.built.model, contacts
        sizes = dict.fromkeys((*BATCHED, "qpos_spring"), n)
        each = max([3, *model.pair_dim.tolist()])
        rows = contacts * each + int(model.jnt_limited.sum()) + int(model.neq)
        with wp.ScopedDevice(self.device):
            self.model = mjw.put_model(model, batch_sizes=sizes)
            # The engine asks for what did not fit; Warp's own messages would come from every step.
            self.model.opt.warn_overflow = 0
            if bool((model.pair_dim == 6).any()):
                self.model.callback.contactfilter = _lay_cylinders
            if self.device.is_cuda:
                # Older drivers cannot end a loop of a graph early (untested).
                self.model.opt.graph_conditional = wp.is_conditional_graph_supported()
            self.data = mjw.make_data(model, nworld=n, nconmax=contacts, njmax=rows)
            self.kept = [(wp.zeros_like(a), a) for a in (self.data.qpos, self.data.qvel, self.data.qacc_warmstart)]
            self.active, self.cleared = wp.zeros(n, dtype=int), wp.zeros(n, dtype=int)
            self.device_links = wp.zeros(self.on_links.shape, dtype=float)
            self.device_between = wp.zeros(self.between.shape, dtype=float)
            links, bodies = self._owners()
            self.link_of, self.body_of = wp.array(links, dtype=int), wp.array(bodies, dtype=int)
        self._graphs: dict[int, wp.Graph | None] = {}
        self.length, self.moved = 0.0, True
        self.other_gains[:] = True

    def _owners(self) -> tuple[Array, Array]:
        """(ngeom,) coordinate of the link of each geom, and number of its rigid body; -1 for none."""
        built, systems = self.built, len(self.systems)
        first = np.cumsum([0, *(slot.v.stop - slot.v.start for slot in self.systems)])
        of_system = (built.owner >= 0) & (built.owner < systems) & (built.link >= 0)
        links = np.where(of_system, first[np.clip(built.owner, 0, systems)] + built.link, -1)
        return links.astype(np.int32), np.where(built.owner >= systems, built.owner - systems, -1).astype(np.int32)

    # State -------------------------------------------------------------------------------------

    def park(self, rows: Array) -> None:
        """Put worlds that are not in use into a state without contacts."""
        model = self.built.model
        self.qpos[rows], self.qvel[rows], self.springs[rows] = model.qpos0, 0.0, model.qpos_spring
        self.mocap_quat[rows] = [1.0, 0.0, 0.0, 0.0]
        for k, slot in enumerate((*self.systems, *self.bodies)):
            position = [APART * k, 0.0, 0.0]
            if slot.mocap >= 0:
                self.mocap_pos[rows, slot.mocap] = position
            else:
                self.qpos[rows, slot.q.start : slot.q.start + 3] = position
        self._begin(rows)

    def _begin(self, rows: Array) -> None:
        """Nothing that happened before affects these rows."""
        self.fresh[rows], self.moved = 1, True
        self.on_links[rows], self.between[rows] = 0.0, 0.0

    def place(self, rows: Array, bases: Array, gc: Array, bodies: Array) -> None:
        """See `WorldBatch.place`."""
        for k, slot in enumerate(self.systems):
            self.mocap_pos[rows, slot.mocap], self.mocap_quat[rows, slot.mocap] = bases[:, k, :3], bases[:, k, 3:]
        self.qpos[np.ix_(rows, self.q)], self.qvel[np.ix_(rows, self.v)] = gc, 0.0
        for k in range(len(self.bodies)):
            self.move(rows, k, bodies[:, k])
        self._begin(rows)

    def move(self, rows: Array, body: int, states: Array) -> None:
        """Set a body's states (R, 13)."""
        slot, state = self.bodies[body], self.frames[body].to_inertial(states)
        if slot.mocap >= 0:
            self.mocap_pos[rows, slot.mocap], self.mocap_quat[rows, slot.mocap] = state[:, :3], state[:, 3:7]
        else:
            self.qpos[rows, slot.q], v = state[:, :7], slot.v.start
            self.qvel[rows, v : v + 3] = state[:, 7:10]
            # A free joint's angular velocity is in the body's axes.
            self.qvel[rows, v + 3 : v + 6] = rotate_back(matrix_from_quaternion(state[:, 3:7]), state[:, 10:])
        self.moved = True

    def set_gains(self, rows: Array, kp: Array, kd: Array, feed_forward: Array) -> None:
        """See `WorldBatch.set_gains`."""
        self.other_gains[rows] |= (self.kp[rows] != kp).any(axis=1) | (self.kd[rows] != kd).any(axis=1)
        self.kp[rows], self.kd[rows], self.moved = kp, kd, True
        self.force[np.ix_(rows, self.v)] = feed_forward

    def read(self, rows: Array, state: BatchState, at: Array) -> None:
        """Write the states of rows into the rows `at` of `state`."""
        state.gc[at], state.gv[at] = self.qpos[np.ix_(rows, self.q)], self.qvel[np.ix_(rows, self.v)]
        for k, (slot, frame) in enumerate(zip(self.bodies, self.frames, strict=True)):
            if slot.mocap >= 0:
                continue
            qpos, qvel = self.qpos[rows, slot.q].astype(float), self.qvel[rows, slot.v].astype(float)
            # A world that breaks computes with NaN.
            with np.errstate(all="ignore"):
                spin = rotate(matrix_from_quaternion(qpos[:, 3:]), qvel[:, 3:])
                states = np.concatenate([qpos, qvel[:, :3], spin], axis=1)
                frame.from_inertial(states)
            state.bodies[at, k] = states

    # Steps -------------------------------------------------------------------------------------

    def advance(self, rows: Array, targets: Array, substeps: int) -> None:
        """Advance some rows by `substeps` timesteps towards targets (R, dof)."""
        steps, length = engine_steps(substeps, self.spec.timestep, self.spec.preset)
        self.springs[np.ix_(rows, self.q)] = targets
        active = np.zeros(len(self.qpos), np.int32)
        active[rows] = 1
        with wp.ScopedDevice(self.device):
            self._upload(active, length)
            self._run(steps)
            while (self.data.overflow.numpy() & _FULL).any():
                self._grow()
                self._upload(active, length)
                self._run(steps)
            self._download(rows)

    def _upload(self, active: Array, length: float) -> None:
        """Bring the device up to date for steps of `length` seconds."""
        m, d = self.model, self.data
        if self.length != length:
            self.built.set_timestep(length)
            self.constants.forget()
            m.opt.timestep.fill_(length)
            for name in TIMED:
                if getattr(self.built.model, name).size:
                    getattr(m, name).assign(getattr(self.built.model, name)[None].astype(np.float32))
            self.length, self.other_gains[:] = length, True
        if self.other_gains.any():
            for i in self.other_gains.nonzero()[0].tolist():
                for array, value in zip(self.values, self.constants.of(i, self.kp[i], self.kd[i]), strict=True):
                    array[i] = value
            for name, array in zip(BATCHED, self.values, strict=True):
                getattr(m, name).assign(array)
            self.other_gains[:] = False
        if self.moved:
            for device_array, array in (
                (d.qpos, self.qpos), (d.qvel, self.qvel), (d.mocap_pos, self.mocap_pos),
                (d.mocap_quat, self.mocap_quat), (d.qfrc_applied, self.force),
            ):  # fmt: skip
                if array.size:
                    device_array.assign(array)
            self.cleared.assign(self.fresh)
            wp.launch(kernels.zero_rows, d.qacc_warmstart.shape, [self.cleared, d.qacc_warmstart])
            self.fresh[:], self.moved = 0, False
        m.qpos_spring.assign(self.springs)
        self.active.assign(active)
        d.overflow.zero_()

    def _run(self, steps: int) -> None:
        """Make some steps of the active worlds, from the second time on as a graph of Warp."""
        if steps not in self._graphs:
            # The first time loads the kernels, which must not happen while a graph is captured.
            self._launch(steps)
            self._graphs[steps] = None
        else:
            graph = self._graphs[steps]
            if graph is None:
                with wp.ScopedCapture(self.device) as capture:
                    self._launch(steps)
                graph = self._graphs[steps] = capture.graph
            wp.capture_launch(graph)
        wp.synchronize_device(self.device)

    def _launch(self, steps: int) -> None:
        m, d = self.model, self.data
        contact, efc = d.contact, d.efc
        for saved, array in self.kept:
            wp.copy(saved, array)
        for blocks in (self.device_links, self.device_between):
            if blocks.size:
                wp.launch(kernels.zero_blocks, blocks.shape, [self.active, blocks])
        for _ in range(steps):
            mjw.step1(m, d)
            wp.launch(kernels.keep_closed, d.naconmax, [
                m.opt.timestep, d.nacon, contact.worldid, contact.friction, contact.efc_address, efc.vel, efc.aref,
            ])  # fmt: skip
            mjw.step2(m, d)
        wp.launch(kernels.add_forces, d.naconmax, [
            self.active, d.nacon, contact.worldid, contact.geom, contact.efc_address, efc.force, self.link_of,
            self.body_of, self.device_links, self.device_between,
        ])  # fmt: skip
        for saved, array in self.kept:
            wp.launch(kernels.put_back, array.shape, [self.active, saved, array])

    def _grow(self) -> None:
        """Make room for twice as many contacts, and go back to before the last steps."""
        if self.contacts * 2 > MOST_CONTACTS:
            raise EngineError(f"a world has more than {self.contacts} contacts; use fewer collision parts")
        warm = self.kept[2][0].numpy().copy()
        self._make(len(self.qpos), 2 * self.contacts)
        self.data.qacc_warmstart.assign(warm)

    def _download(self, rows: Array) -> None:
        """Read the device's state; park the rows that broke, so that they do not disturb others."""
        self.qpos[:], self.qvel[:] = self.data.qpos.numpy(), self.data.qvel.numpy()
        self.on_links[rows] = self.device_links.numpy()[rows]
        self.between[rows] = self.device_between.numpy()[rows]


def _lay_cylinders(m: mjw.Model, d: mjw.Data) -> None:
    """Correct the contacts that a step has just found, see `kernels.lay_cylinders`."""
    contact = d.contact
    wp.launch(kernels.lay_cylinders, d.naconmax, [
        d.nacon, contact.worldid, contact.geom, contact.dim, m.geom_type, m.geom_size, d.geom_xpos, d.geom_xmat,
        contact.pos, contact.dist, contact.frame,
    ])  # fmt: skip
