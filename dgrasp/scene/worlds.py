"""The N simulated worlds of an environment: made, placed, stepped together, and read into a `SceneState`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.scene import LOWERED_TOP, TABLE_TOP, Scene
from dgrasp.types import Array, GraspLabel, SceneState, StartPose
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.world import integrate

MAX_SPEED, MAX_SPIN = 50.0, 1000.0
"""m/s and rad/s of the object, beyond which the simulation has exploded."""
MAX_FALL = 1000.0
"""m/s below the floor (z = 0), where what has missed the table falls on and on."""


class Worlds:
    """One scene per label. What they report is written into `state`, whose arrays stay the caller's."""

    def __init__(
        self, labels: Sequence[GraspLabel], hand: HandModel, objects: Mapping[str, ObjectModel], config: Config,
        make_scene: Callable[..., Scene], state: SceneState,
    ) -> None:  # fmt: skip
        self.labels, self.hand, self.objects, self.config = labels, hand, objects, config
        self.make_scene, self.s = make_scene, state
        self.scenes = [self._new_scene(label) for label in labels]
        state.object_mass[:] = [scene.object_model.mass for scene in self.scenes]
        self._object_state = np.zeros((len(labels), 13))
        self._retired_seconds = np.zeros(len(labels))

    def _new_scene(self, label: GraspLabel) -> Scene:
        physics = self.config.physics
        if not label.on_table:
            # Such grasps may come from below (supplement, B.5: no collision between hand and surface).
            physics = physics.model_copy(update={"hand_table_collision": False})
        return self.make_scene(self.hand, self.objects[label.object_id], physics, self.config.engine)

    def rebuild(self, i: int) -> None:
        """A world that exploded keeps its NaNs; only a new one is clean."""
        self._retired_seconds[i] += self.scenes[i].world.engine_world.step_seconds
        self.scenes[i].close()
        self.scenes[i] = self._new_scene(self.labels[i])

    def close(self) -> None:
        """Free all worlds."""
        for scene in self.scenes:
            scene.close()

    @property
    def seconds(self) -> Array:
        """(N,) wall seconds inside the engine's step so far."""
        return self._retired_seconds + [scene.world.engine_world.step_seconds for scene in self.scenes]

    def place(self, i: int, start: StartPose, table_top: float, kp_position: float, carries: bool) -> None:
        """Begin anew in one world, everything at rest; gains as for `set_gains`."""
        self.scenes[i].place(start.T_WH, start.hand_pose, start.T_WO, table_top)
        self.set_gains(i, kp_position, carries)
        s = self.s
        s.R_WH0[i], s.wrist_start_W[i] = start.T_WH[:3, :3], start.T_WH[:3, 3]
        s.object_start_W[i], s.table_height_W[i] = start.T_WO[:3, 3], TABLE_TOP
        self.read(i)
        s.contact_impulse[i], s.table_contact[i] = 0.0, 0.0

    def set_gains(self, i: int, kp_position: float, carries: bool = True) -> None:
        """How stiff a wrist is, and whether it is to carry the object's weight."""
        scene = self.scenes[i]
        scene.set_gains(self.config.env.action, kp_position, scene.object_model.mass if carries else 0.0)

    def release(self, i: int, kp_position: float) -> None:
        """Take the table of one world away, and set how stiff its wrist is from now on."""
        self.scenes[i].set_table_top(LOWERED_TOP)
        self.set_gains(i, kp_position)

    def advance(self, rows: Sequence[int], target: Array, watch_table: bool) -> None:
        """The physics of one control step in some worlds, towards PD targets (N, 51); watch_table: whether the object
        touches the table is asked too."""
        for i in rows:
            self.scenes[i].set_target(target[i])
        integrate([self.scenes[i].world for i in rows], self.config.physics.substeps)
        for i in rows:
            self.read(i)
            if watch_table:
                self.s.table_contact[i] = self.scenes[i].touches_table()

    def read(self, i: int) -> None:
        """What the engine says of one world."""
        self.scenes[i].read(self.s.gc[i], self.s.gv[i], self.s.contact_impulse[i], self._object_state[i])

    def derive(self, rows: slice | Array) -> None:
        """Everything in the state that follows from what was read."""
        s, body = self.s, self._object_state[rows]
        s.object_pos_W[rows] = body[:, :3]
        s.R_WO[rows] = matrix_from_quaternion(body[:, 3:7])
        s.object_linvel_W[rows], s.object_angvel_W[rows] = body[:, 7:10], body[:, 10:13]
        s.contacts[rows] = s.contact_impulse[rows] > 0.0
        s.R_WH[rows], s.joints_W[rows] = self.hand.forward(s.gc[rows], s.R_WH0[rows], s.wrist_start_W[rows])

    def exploded(self) -> Array:
        """(N,) bool: whose state is infinite, NaN or absurdly fast."""
        body = self._object_state
        allowed = np.where(body[:, 2:3] < 0.0, MAX_FALL, MAX_SPEED)
        sane = (
            np.isfinite(self.s.gc).all(axis=1)
            & np.isfinite(self.s.gv).all(axis=1)
            & np.isfinite(body).all(axis=1)
            & (np.abs(body[:, 7:10]) < allowed).all(axis=1)
            & (np.abs(body[:, 10:13]) < MAX_SPIN).all(axis=1)
        )
        return np.asarray(~sane)
