"""The N simulated worlds of an environment: make, place and step them, and read them into a `SceneState`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.scene import (
    LOWERED_TOP,
    OBJECT,
    TABLE,
    TABLE_TOP,
    carrying_force,
    position_and_quaternion,
    resting_state,
    scene_spec,
    table_state,
    wrist_gains,
)
from dgrasp.types import Array, GraspLabel, SceneState, StartPose
from raisim_like.batch import BatchState, WorldSpec
from raisim_like.registry import make_batch
from raisim_like.rotations import matrix_from_quaternion

MAX_SPEED, MAX_SPIN = 50.0, 1000.0
"""m/s and rad/s. If the object is faster, the simulation has exploded."""
MAX_FALL = 1000.0
"""m/s. The limit below the floor (z = 0), where an object that has missed the table keeps falling."""


class Worlds:
    """One world per label. The worlds write their readings into `state`, whose arrays the caller owns."""

    def __init__(
        self, labels: Sequence[GraspLabel], hand: HandModel, objects: Mapping[str, ObjectModel], config: Config,
        state: SceneState, threads: int = 1,
    ) -> None:  # fmt: skip
        self.hand, self.config, self.s = hand, config, state
        self.specs = [self._spec(label, objects[label.object_id]) for label in labels]
        state.object_mass[:] = [spec.bodies[OBJECT].mass for spec in self.specs]
        n = len(labels)
        bodies = np.zeros((n, 2, 13))
        self.batch = make_batch(config.engine, self.specs, BatchState(state.gc, state.gv, bodies), threads)
        self._object_state = bodies[:, OBJECT]
        self._link_impulse = np.zeros((n, hand.urdf.dof))

    def _spec(self, label: GraspLabel, model: ObjectModel) -> WorldSpec:
        physics = self.config.physics
        if not label.on_table:
            # Such grasps may come from below (supplement, B.5: no collision between hand and surface).
            physics = physics.model_copy(update={"hand_table_collision": False})
        return scene_spec(self.hand, model, physics)

    def rebuild(self, i: int) -> None:
        """Make a new world in place of one that exploded. Call `place` for it next."""
        self.batch.rebuild([i])

    def close(self) -> None:
        """Free all worlds."""
        self.batch.close()

    @property
    def seconds(self) -> Array:
        """(N,) wall seconds inside the engine's step so far."""
        return self.batch.seconds

    def place(self, i: int, start: StartPose, table_top: float, kp_position: float, carries: bool) -> None:
        """Start one world anew with everything at rest. kp_position, carries: see `set_gains`."""
        gc = np.zeros((1, self.hand.urdf.dof))
        gc[0, -len(start.hand_pose) :] = start.hand_pose
        bodies = np.stack([resting_state(start.T_WO), table_state(table_top)])
        self.batch.place([i], position_and_quaternion(start.T_WH)[None, None], gc, bodies[None])
        s = self.s
        s.R_WH0[i], s.wrist_start_W[i] = start.T_WH[:3, :3], start.T_WH[:3, 3]
        s.object_start_W[i], s.table_height_W[i] = start.T_WO[:3, 3], TABLE_TOP
        self.set_gains(i, kp_position, carries)
        self._link_impulse[i], s.contact_impulse[i], s.table_contact[i] = 0.0, 0.0, 0.0

    def set_gains(self, i: int, kp_position: float, carries: bool = True) -> None:
        """Set the stiffness (N/m) of a wrist's position, and whether a feed-forward carries the object's weight."""
        spec = self.specs[i]
        kp, kd = wrist_gains(self.hand, self.config.env.action, kp_position)
        carried_mass = spec.bodies[OBJECT].mass if carries else 0.0
        force = carrying_force(self.hand, np.array(spec.gravity), self.s.R_WH0[i], carried_mass)
        self.batch.set_gains([i], kp[None], kd[None], force[None])

    def release(self, i: int, kp_position: float) -> None:
        """Take the table of one world away, and set the stiffness (N/m) of its wrist from now on."""
        self.batch.move([i], TABLE, table_state(LOWERED_TOP)[None])
        self.set_gains(i, kp_position)

    def advance(self, rows: Sequence[int], target: Array, watch_table: bool) -> None:
        """Simulate one control step of some worlds towards PD targets (N, dof).

        watch_table: also update which objects touch their table.
        """
        self.batch.advance(rows, target, self.config.physics.substeps)
        self.batch.link_impulses(rows, OBJECT, self._link_impulse)
        # With a mode other than "raise", take writes into `out` without a buffer.
        np.take(self._link_impulse, self.hand.part_links, axis=1, out=self.s.contact_impulse, mode="clip")
        if watch_table:
            self.batch.touching(rows, OBJECT, TABLE, self.s.table_contact)

    def derive(self, rows: slice | Array) -> None:
        """Compute, in rows (n,) or all, everything in the state that follows from the engine's readings."""
        s, body = self.s, self._object_state[rows]
        s.object_pos_W[rows] = body[:, :3]
        s.R_WO[rows] = matrix_from_quaternion(body[:, 3:7])
        s.object_linvel_W[rows], s.object_angvel_W[rows] = body[:, 7:10], body[:, 10:13]
        s.contacts[rows] = s.contact_impulse[rows] > 0.0
        s.R_WH[rows], s.joints_W[rows] = self.hand.forward(s.gc[rows], s.R_WH0[rows], s.wrist_start_W[rows])

    def exploded(self) -> Array:
        """(N,) bool: worlds whose state is infinite, NaN or absurdly fast."""
        body = self._object_state
        allowed = np.where(body[:, 2:3] < 0.0, MAX_FALL, MAX_SPEED)
        slow = (np.abs(body[:, 7:10]) < allowed).all(axis=1) & (np.abs(body[:, 10:13]) < MAX_SPIN).all(axis=1)
        return np.asarray(self.batch.broken() | ~slow)
