"""Labels, hand and objects for tests that simulate: made here from the free hand, no file but its URDF."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgrasp.config.experiment import Config, load_config
from dgrasp.config.sections import ActionConfig, PhysicsConfig
from dgrasp.files.paths import data_root
from dgrasp.hand.load import load_hand
from dgrasp.hand.mano.model import MIRROR
from dgrasp.hand.mano.skeleton import N_PARTS
from dgrasp.hand.model import HandModel
from dgrasp.objects.free import free_object
from dgrasp.objects.model import ObjectModel
from dgrasp.pool import PoolSpec
from dgrasp.scene.scene import (
    OBJECT,
    TABLE,
    carrying_force,
    position_and_quaternion,
    resting_state,
    scene_spec,
    table_state,
    wrist_gains,
)
from dgrasp.types import Array, GraspLabel, StartPose
from raisim_like import ArticulatedSystem, RigidBody
from raisim_like.batch import BatchState
from raisim_like.loop import LoopBatch
from raisim_like.registry import make_batch
from raisim_like.rotations import matrix_from_euler, transform


def free_hand() -> HandModel:
    """The hand that ships."""
    return load_hand(data_root() / "free" / "hand" / "free_hand.urdf", "free")


def mirrored(hand: HandModel) -> HandModel:
    """The left hand that is the mirror image of a right one."""
    chain = replace(hand.chain, offsets=hand.offsets * MIRROR, keypoint_offsets=hand.chain.keypoint_offsets * MIRROR)
    return replace(hand, chain=chain, layout=replace(hand.layout, side="left"))


LAYOUT = free_hand().layout
"""Its names and sizes."""


def make_label(hand: HandModel, object_id: str = "004_sugar_box", index: int = 0, flexion: float = 0.5) -> GraspLabel:
    """A hand above an object that stands on the table, fingers down; it need not hold anything."""
    fingers = np.zeros(45)
    fingers[2::3] = flexion
    R = matrix_from_euler(np.array([0.0, -np.pi / 2, 0.0]))
    wrist = np.array([0.5, 0.2 + 0.01 * index, 0.5 + 0.32])
    gc = np.zeros((1, 51))
    gc[0, 6:] = fingers
    _, joints = hand.forward(gc, R[None], wrist[None])
    T_WO = transform(np.eye(3), np.array([0.5, 0.2, 0.5 + 0.0875]))
    contacts = np.zeros(N_PARTS, bool)
    contacts[[3, 15]] = True
    start = StartPose(transform(R, wrist + np.array([0.0, 0.0, 0.1])), T_WO, np.zeros(45))
    return GraspLabel(
        object_id, fingers, transform(R, wrist), T_WO, joints[0], contacts, start, "free", "test", index
    )


def make_spec(count: int = 3, overrides: list[str] | None = None) -> PoolSpec:
    """A pool's specification with `count` labels of one box."""
    config: Config = load_config(None, overrides)
    hand = free_hand()
    name = "004_sugar_box"
    objects = {name: free_object(name, config.physics.masses, config.physics.authors_inertia(False))}
    return PoolSpec([make_label(hand, name, i) for i in range(count)], hand, objects, config)


class OneScene:
    """One world of hand, object and table, driven through the door that environments use.

    `world`, `hand`, `object` and `table` are RaiSim's view of it.
    """

    def __init__(self, hand: HandModel, model: ObjectModel, physics: PhysicsConfig, engine: str) -> None:
        self.hand_model, self.object_model, self.spec = hand, model, scene_spec(hand, model, physics)
        n = hand.urdf.dof
        self.state = BatchState(np.full((1, n), np.nan), np.full((1, n), np.nan), np.full((1, 2, 13), np.nan))
        self.batch = make_batch(engine, [self.spec], self.state)
        assert isinstance(self.batch, LoopBatch)
        (self.world,) = self.batch.worlds
        self.hand: ArticulatedSystem
        self.object: RigidBody
        self.table: RigidBody
        self.hand, self.object, self.table = self.world.objects  # type: ignore[assignment]
        self.target, self.R_WH0 = np.zeros((1, n)), np.eye(3)

    def close(self) -> None:
        """Free the world."""
        self.batch.close()

    def place(self, T_WH0: Array, hand_pose: Array, T_WO: Array, table_top: float) -> None:
        """Hand base (4, 4), fingers (45,), object (4, 4) and table (m), all at rest."""
        self.R_WH0 = T_WH0[:3, :3]
        gc = np.concatenate([np.zeros(6), hand_pose])
        bodies = np.stack([resting_state(T_WO), table_state(table_top)])
        self.batch.place([0], position_and_quaternion(T_WH0)[None, None], gc[None], bodies[None])

    def set_table_top(self, height: float) -> None:
        """Move the table alone."""
        self.batch.move([0], TABLE, table_state(height)[None])

    def set_gains(self, action: ActionConfig, kp_position: float, carried_mass: float) -> None:
        """Gains, and the force that carries the hand and a mass (kg)."""
        kp, kd = wrist_gains(self.hand_model, action, kp_position)
        force = carrying_force(self.hand_model, np.array(self.spec.gravity), self.R_WH0, carried_mass)
        self.batch.set_gains([0], kp[None], kd[None], force[None])

    def set_target(self, target: Array) -> None:
        """PD target (51,) of all further steps."""
        self.target[0] = target

    def advance(self, substeps: int) -> None:
        """Towards the target."""
        self.batch.advance([0], self.target, substeps)

    def read(self) -> tuple[Array, Array, Array, Array]:
        """Coordinates, velocities (51,), impulses on the parts (16,) and the object's state (13,)."""
        impulse = np.full((1, self.hand_model.urdf.dof), np.nan)
        self.batch.link_impulses([0], OBJECT, impulse)
        gc, gv, body = (array.copy() for array in (self.state.gc[0], self.state.gv[0], self.state.bodies[0, OBJECT]))
        return gc, gv, impulse[0, self.hand_model.part_links], body

    def touches_table(self) -> bool:
        """Whether the object pressed on the table in the last substep."""
        out = np.full(1, np.nan)
        self.batch.touching([0], OBJECT, TABLE, out)
        return bool(out[0])
