"""MuJoCo as an implementation of the engine protocol: worlds, control, contacts."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache

import mujoco as mj
import numpy as np

from raisim_like.batch import Preset
from raisim_like.contact import Contact
from raisim_like.engines.body_frame import BodyFrame
from raisim_like.engines.mujoco import state as mujoco_state
from raisim_like.engines.mujoco.built import BuiltModel
from raisim_like.engines.mujoco.contacts import contacts_of, pair_forces
from raisim_like.engines.mujoco.model import Drive, Item, Solid, System
from raisim_like.engines.mujoco.sliding import advance
from raisim_like.engines.pending import Pending
from raisim_like.engines.protocol import Array, EngineWorld, engine_steps
from raisim_like.errors import EngineError
from raisim_like.material import MaterialTable
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel


def _report(message: str) -> None:
    """Print a warning of MuJoCo, which would otherwise go to a file in the working directory."""
    # A broken world is visible in its state, which stays NaN.
    if "unstable" not in message:
        print(f"MuJoCo: {message}", file=sys.stderr)


mj.set_mju_user_warning(_report)


class MujocoWorld:
    """One model with its data. See `EngineWorld` for the methods.

    After bodies were added or removed, the model is compiled when it is next needed, and states are carried over. With
    the fast preset one engine step covers up to two timesteps; impulses are still those of one timestep.
    """

    def __init__(self, timestep: float, preset: Preset = "faithful") -> None:
        self.timestep, self.preset = timestep, preset
        self.step_seconds = 0.0
        self.solids: dict[int, Solid] = {}
        self.systems: dict[int, System] = {}
        self._next_id = 0
        self._gravity: Array = np.zeros(3)
        self._materials = MaterialTable()
        self._built: BuiltModel | None = None
        self._stale = True
        self._pending = Pending()

    def close(self) -> None:
        self._built, self._stale = None, True

    def set_gravity(self, gravity: Array) -> None:
        self._gravity = np.array(gravity, dtype=float)
        if self._built is not None:
            self._built.model.opt.gravity = self._gravity

    # Bodies ------------------------------------------------------------------------------------

    def add_body(
        self, shapes: Sequence[Shape], mass: float, com: Array, inertia: Array, material: str, collision_mask: int
    ) -> int:
        if not shapes:
            raise EngineError("a body needs at least one shape")
        for shape in shapes:
            if shape.kind == "mesh":
                raise EngineError(
                    f"{shape.file}: MuJoCo has no concave meshes and would take the convex hull; give the body convex "
                    "parts instead, one shape of kind 'hull' for each"
                )
            if shape.kind == "hull" and (shape.file is None or not shape.file.is_file()):
                raise EngineError(f"mesh file {shape.file} does not exist")
        body = self._new_id()
        self.solids[body] = Solid(tuple(shapes), float(mass), BodyFrame(com, inertia), material, collision_mask)
        return body

    def add_articulated(
        self, model: UrdfModel, material: str, collision_mask: int, self_collision: bool, enforce_limits: bool
    ) -> int:
        body, drive = self._new_id(), Drive(model.dof)
        self.systems[body] = System(model, material, collision_mask, self_collision, enforce_limits, drive)
        return body

    def _new_id(self) -> int:
        self._stale = True
        self._next_id += 1
        return self._next_id - 1

    def remove(self, body: int) -> None:
        self._stale = True
        for items in (self.solids, self.systems):
            items.pop(body, None)
        self._pending.forget(body)

    def apply_materials(self, table: MaterialTable) -> None:
        if table != self._materials:
            self._materials = MaterialTable(table.default_friction, dict(table.pairs))
            self._stale = True

    def _ready(self) -> BuiltModel:
        """The compiled model of the current bodies."""
        if self._built is not None and not self._stale:
            return self._built
        items: dict[int, Item] = {**self.solids, **self.systems}
        old, new = self._built, BuiltModel(items, self._materials, self.timestep, self._gravity, self.preset)
        for body, slot in new.slots.items():
            if body in self.systems:
                new.set_gains(slot, self.systems[body])
        if old is not None:
            mujoco_state.carry_over(old, new)
        self._built, self._stale = new, False
        return new

    def set_body_state(self, body: int, state: Array) -> None:
        built = self._ready()
        mujoco_state.write_body(built.data, built.slots[body], self.solids[body].frame.to_inertial(state))

    def get_body_state(self, body: int, out: Array) -> None:
        built = self._ready()
        mujoco_state.read_body(built.data, built.slots[body], out)
        self.solids[body].frame.from_inertial(out)

    # Articulated systems -----------------------------------------------------------------------

    def set_base_pose(self, body: int, position: Array, quaternion: Array) -> None:
        built = self._ready()
        mocap = built.slots[body].mocap
        built.data.mocap_pos[mocap], built.data.mocap_quat[mocap] = position, quaternion

    def set_joint_state(self, body: int, gc: Array, gv: Array) -> None:
        data, slot = self._ready().data, self._ready().slots[body]
        data.qpos[slot.q], data.qvel[slot.v] = gc, gv

    def get_joint_state(self, body: int, gc: Array, gv: Array) -> None:
        data, slot = self._ready().data, self._ready().slots[body]
        gc[:], gv[:] = data.qpos[slot.q], data.qvel[slot.v]

    def set_pd_gains(self, body: int, kp: Array, kd: Array) -> None:
        drive = self.systems[body].drive
        if np.array_equal([kp, kd], [drive.kp, drive.kd]):
            return
        drive.kp[:], drive.kd[:] = kp, kd
        if self._built is not None and not self._stale:
            self._built.set_gains(self._built.slots[body], self.systems[body])

    def set_pd_target(self, body: int, target: Array) -> None:
        self.systems[body].drive.target[:] = target

    def set_feed_forward(self, body: int, force: Array) -> None:
        self.systems[body].drive.feed_forward[:] = force

    def apply_wrench(self, body: int, force: Array, torque: Array) -> None:
        self._pending.add_wrench(body, force, torque)

    def apply_generalized_force(self, body: int, force: Array) -> None:
        self._pending.add_generalized(body, force)

    def mass_matrix(self, body: int) -> Array:
        built = self._ready()
        m, d, v = built.model, built.data, built.slots[body].v
        mj.mj_kinematics(m, d)
        mj.mj_comPos(m, d)
        mj.mj_makeM(m, d)
        whole = np.zeros((m.nv, m.nv))
        mj.mj_fullM(m, d, whole)
        # The armature belongs to the controller.
        return whole[v, v] - np.diag(m.dof_armature[v])

    def link_poses(self, body: int) -> tuple[Array, Array]:
        built = self._ready()
        links = built.slots[body].bodies
        mj.mj_kinematics(built.model, built.data)
        return built.data.xmat[links].reshape(-1, 3, 3).copy(), built.data.xpos[links].copy()

    def forget_contacts(self) -> None:
        mujoco_state.forget_contacts(self._ready())

    def _steps(self, built: BuiltModel, substeps: int) -> int:
        """The number of engine steps that make up `substeps` timesteps; sets the model to their length."""
        steps, length = engine_steps(substeps, self.timestep, self.preset)
        if built.length != length:
            built.set_timestep(length)
            for body, system in self.systems.items():
                built.set_gains(built.slots[body], system)
        return steps

    def step(self, substeps: int) -> None:
        """Advance by `substeps` timesteps under the current targets and forces."""
        built = self._ready()
        steps = self._steps(built, substeps)
        for drive, spring, _ in built.drives:
            spring[:] = drive.target
        built.write_forces()
        start = time.perf_counter()
        if self._pending and substeps > 0:
            mujoco_state.begin_pending(built, self._pending, self.timestep / built.length)
            advance(built.model, built.data, 1)
            mujoco_state.end_pending(built)
            self._pending, steps = Pending(), steps - 1
        advance(built.model, built.data, steps)
        self.step_seconds += time.perf_counter() - start

    def bare_step(self, substeps: int) -> float:
        built = self._ready()
        steps = self._steps(built, substeps)
        start = time.perf_counter()
        mj.mj_step(built.model, built.data, nstep=steps)
        return time.perf_counter() - start

    def save(self) -> mujoco_state.MujocoSnapshot:
        drives = {body: system.drive for body, system in self.systems.items()}
        return mujoco_state.MujocoSnapshot.of(self._ready(), drives, self._pending)

    def restore(self, snapshot: mujoco_state.MujocoSnapshot) -> None:
        built = self._ready()
        if built is not snapshot.built:
            raise EngineError("bodies were added or removed, or materials were changed, since the snapshot was taken")
        for body, system in self.systems.items():
            system.drive.copy(snapshot.drives[body])
            built.set_gains(built.slots[body], system)
        mj.mj_copyData(built.data, built.model, snapshot.data)
        self._pending = snapshot.pending.copy()

    # Contacts ---------------------------------------------------------------------------------

    def link_impulses(self, body: int, other: int, out: Array) -> None:
        out[:] = 0.0
        links, forces = pair_forces(self._ready(), body, other)
        np.add.at(out, links, forces * self.timestep)

    def touching(self, body: int, other: int) -> bool:
        return bool((pair_forces(self._ready(), body, other)[1] > 0.0).any())

    def contacts(self, body: int) -> list[Contact]:
        return contacts_of(self._ready(), body, self.timestep)


class MujocoEngine:
    """MuJoCo. Its worlds are independent models; one process may hold many."""

    name = "mujoco"

    def make_world(self, timestep: float, preset: Preset) -> EngineWorld:
        return MujocoWorld(timestep, preset)

    def integrate(self, worlds: Sequence[EngineWorld], substeps: int, threads: int = 1) -> None:
        # Control is part of the model, so each world takes all of its substeps at once. Threads take the next world
        # that is left: an iterator gives each of its items to one of them.
        left = iter([world for world in worlds if isinstance(world, MujocoWorld)])

        def run() -> None:
            for world in left:
                world.step(substeps)

        if threads == 1:
            run()
            return
        others = [_threads(threads - 1).submit(run) for _ in range(threads - 1)]
        try:
            run()
        finally:
            # After an error too, the others finish the worlds that are left.
            wait(others)
        for other in others:
            other.result()


@cache
def _threads(count: int) -> ThreadPoolExecutor:
    """Threads that wait for worlds to step; they end with the process."""
    return ThreadPoolExecutor(count, "dgrasp-mujoco")
