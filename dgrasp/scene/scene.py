"""Hand, object and table in one world: its bodies, the table's place, and the hand's gains and feed-forward."""

from __future__ import annotations

import numpy as np

from dgrasp.config.sections import ActionConfig, PhysicsConfig
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import ObjectModel
from dgrasp.types import Array
from raisim_like.batch import BodySpec, SystemSpec, WorldSpec
from raisim_like.material import MaterialTable
from raisim_like.rotations import quaternion_from_matrix
from raisim_like.shapes import Shape
from raisim_like.world import BODY, STATIC, SYSTEM, collision_mask

TABLE_TOP = 0.5
"""m. Height of the table's top in the labels."""
LOWERED_TOP = 0.25
"""m. Height of the table's top after the table has been taken away."""
TABLE_SIZE = (2.0, 1.0, 0.5)
TABLE_XY = (1.25, 0.0)
CARRY_ACCELERATION = 10.0
"""m/s^2. Gravity in the feed-forward for the object's weight (docs/deviations.md)."""
OBJECT, TABLE = 0, 1
"""Indices of a scene's bodies."""


def scene_spec(hand: HandModel, model: ObjectModel, physics: PhysicsConfig) -> WorldSpec:
    """A world with the hand as its only system, the object and the table."""
    hits = BODY | (STATIC if physics.hand_table_collision else 0)
    system = SystemSpec(
        hand.urdf, "hand", collision_mask(SYSTEM, hits | (SYSTEM if physics.self_collision else 0)),
        self_collision=physics.self_collision,
        # PD targets are clipped to the limits, and 50 N m/rad keeps the joints there.
        enforce_limits=False,
    )  # fmt: skip
    thing = BodySpec(
        model.shapes, model.mass, model.inertia, model.center_of_mass_O, "object",
        collision_mask(BODY, STATIC | SYSTEM),
    )  # fmt: skip
    table = BodySpec(
        (Shape("box", TABLE_SIZE),), 0.0, np.eye(3), np.zeros(3), "table",
        collision_mask(STATIC, BODY | (SYSTEM if physics.hand_table_collision else 0)),
    )  # fmt: skip
    return WorldSpec(
        (system,), (thing, table), physics.timestep, physics.preset, materials=MaterialTable(physics.friction)
    )


def resting_state(T: Array) -> Array:
    """(13,) state of a body that rests at T_WB (4, 4)."""
    return np.concatenate([position_and_quaternion(T), np.zeros(6)])


def position_and_quaternion(T: Array) -> Array:
    """(7,) position and quaternion of T (4, 4)."""
    return np.concatenate([T[:3, 3], quaternion_from_matrix(T[:3, :3])])


def table_state(height: float) -> Array:
    """(13,) state of the table with its top at `height`, m, world."""
    state = np.zeros(13)
    state[:4] = *TABLE_XY, height - TABLE_SIZE[2] / 2, 1.0
    return state


def wrist_gains(hand: HandModel, action: ActionConfig, kp_position: float) -> tuple[Array, Array]:
    """PD gains kp and kd (dof,): stiffness `kp_position` (N/m) for the wrist's position, all else from `action`."""
    kp = np.full(hand.urdf.dof, action.kp_rotation)
    kd = np.full(hand.urdf.dof, action.kd_rotation)
    kp[:3], kd[:3] = kp_position, action.kd_position
    return kp, kd


def carrying_force(hand: HandModel, gravity: Array, R_WH0: Array, carried_mass: float) -> Array:
    """(dof,) feed-forward that lifts the wrist: the hand's own weight, and `carried_mass` (kg) times 10 m/s^2.

    The hand hangs on a fixed base at the initial wrist frame H0 (R_WH0), so its first three coordinates are along the
    axes of H0. The feed-forward carries the hand as an arm would: without it, at 50 N/m, the hand would hang 7 cm below
    its goal. In the authors' URDF the hand weighs little at these joints, so its weight is left to the policy.
    gravity: (3,) m/s^2, world.
    """
    lift = -gravity * hand.carried_mass
    lift[2] += CARRY_ACCELERATION * carried_mass
    force = np.zeros(hand.urdf.dof)
    force[:3] = R_WH0.T @ lift
    return force
