"""Hand, object and table in one world: set up, placed, read."""

from __future__ import annotations

import numpy as np

from dgrasp.config.sections import ActionConfig, PhysicsConfig
from dgrasp.hand.mano.skeleton import N_DOF
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import ObjectModel
from dgrasp.types import Array
from raisim_like.rotations import quaternion_from_matrix
from raisim_like.shapes import Shape
from raisim_like.world import BODY, STATIC, SYSTEM, World, collision_mask

TABLE_TOP = 0.5
"""m. The top of the table that the labels know."""
LOWERED_TOP = 0.25
"""m. Where the top is after the table has been taken away."""
TABLE_SIZE = (2.0, 1.0, 0.5)
TABLE_XY = (1.25, 0.0)
CARRY_ACCELERATION = 10.0
"""m/s^2 that the feed-forward counts for gravity (docs/deviations.md)."""


class Scene:
    """One world with a hand, an object and a table.

    The hand hangs on a fixed base at the initial wrist frame H0, so its first six coordinates are relative
    to H0. Its weight is carried by a feed-forward on the wrist's position, as if by an arm: at 50 N/m it would
    hang 7 cm below its goal. The authors' hand weighs little there, as its URDF is made, and is left to the policy.
    """

    def __init__(self, hand: HandModel, model: ObjectModel, physics: PhysicsConfig, engine: str) -> None:
        self.hand_model, self.object_model = hand, model
        self.world = World(engine, physics.timestep, physics.preset)
        self.world.set_default_material(physics.friction)
        hits = BODY | (STATIC if physics.hand_table_collision else 0)
        self.hand = self.world.add_articulated_system(
            hand.urdf, "hand", collision_mask(SYSTEM, hits | (SYSTEM if physics.self_collision else 0)),
            self_collision=physics.self_collision,
            # PD targets are clipped to the limits, and 50 N m/rad keeps the joints there.
            enforce_limits=False,
        )  # fmt: skip
        self.object = self.world.add_body(
            model.shapes, model.mass, model.inertia, model.center_of_mass_O, "object",
            collision_mask(BODY, STATIC | SYSTEM),
        )  # fmt: skip
        self.table = self.world.add_body(
            [Shape("box", TABLE_SIZE)], 0.0, np.eye(3), material="table",
            mask=collision_mask(STATIC, BODY | (SYSTEM if physics.hand_table_collision else 0)),
        )  # fmt: skip
        self._engine = self.world.engine_world
        self._object_state = np.zeros(13)
        self._link_impulse = np.zeros(N_DOF)
        self.R_WH0 = np.eye(3)

    def close(self) -> None:
        """Free the world."""
        self.world.close()

    def set_table_top(self, height: float) -> None:
        """Put the table's top at a height (m, world)."""
        self.table.set_state((*TABLE_XY, height - TABLE_SIZE[2] / 2))

    def place(self, T_WH0: Array, hand_pose: Array, T_WO: Array, table_top: float) -> None:
        """Put hand base (4, 4), fingers (45,), object (4, 4) and table (m), all at rest and without a past."""
        self._engine.forget_contacts()
        self.set_table_top(table_top)
        self.R_WH0 = T_WH0[:3, :3]
        self.hand.set_base_pose(T_WH0[:3, 3], quaternion_from_matrix(T_WH0[:3, :3]))
        gc = np.zeros(N_DOF)
        gc[6:] = hand_pose
        self.hand.set_state(gc)
        self.object.set_state(T_WO[:3, 3], quaternion_from_matrix(T_WO[:3, :3]))

    def set_gains(self, action: ActionConfig, kp_position: float, carried_mass: float) -> None:
        """PD gains, and an upward feed-forward on the wrist: `carried_mass` (kg) times 10 m/s^2, the hand's weight."""
        kp = np.full(N_DOF, action.kp_rotation)
        kd = np.full(N_DOF, action.kd_rotation)
        kp[:3], kd[:3] = kp_position, action.kd_position
        self.hand.set_pd_gains(kp, kd)
        force = np.zeros(N_DOF)
        lift = -self.world.gravity * self.hand_model.carried_mass
        lift[2] += CARRY_ACCELERATION * carried_mass
        force[:3] = self.R_WH0.T @ lift
        self.hand.set_generalized_force(force)

    def set_target(self, target: Array) -> None:
        """PD target (51,), already clipped and finite: the per-step path does not check it again."""
        self._engine.set_pd_target(self.hand.id, target)

    def read(self, gc: Array, gv: Array, impulse: Array, object_state: Array) -> None:
        """Writes coordinates, velocities (51,), part impulses (16,) and the object's state (13,)."""
        self._engine.get_joint_state(self.hand.id, gc, gv)
        self._engine.link_impulses(self.hand.id, self.object.id, self._link_impulse)
        impulse[:] = self._link_impulse[self.hand_model.part_links]
        self._engine.get_body_state(self.object.id, object_state)

    def touches_table(self) -> bool:
        """Whether the object pressed on the table in the last substep."""
        return self._engine.touching(self.object.id, self.table.id)
