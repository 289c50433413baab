"""Labels, hand and objects for tests that simulate: made here from the free hand, no file but its URDF."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgrasp.config.experiment import Config, load_config
from dgrasp.files.paths import data_root
from dgrasp.hand.load import load_hand
from dgrasp.hand.mano.model import MIRROR
from dgrasp.hand.mano.skeleton import N_PARTS
from dgrasp.hand.model import HandModel
from dgrasp.objects.free import free_object
from dgrasp.pool import PoolSpec
from dgrasp.types import GraspLabel, StartPose
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
    pose = np.zeros(45)
    pose[2::3] = flexion
    R = matrix_from_euler(np.array([0.0, -np.pi / 2, 0.0]))
    wrist = np.array([0.5, 0.2 + 0.01 * index, 0.5 + 0.32])
    gc = np.zeros((1, 51))
    gc[0, 6:] = pose
    _, joints = hand.forward(gc, R[None], wrist[None])
    T_WO = transform(np.eye(3), np.array([0.5, 0.2, 0.5 + 0.0875]))
    contacts = np.zeros(N_PARTS, bool)
    contacts[[3, 15]] = True
    start = StartPose(transform(R, wrist + np.array([0.0, 0.0, 0.1])), T_WO, np.zeros(45))
    return GraspLabel(object_id, pose, transform(R, wrist), T_WO, joints[0], contacts, start, "free", "test", index)


def make_spec(count: int = 3, overrides: list[str] | None = None) -> PoolSpec:
    """A pool's specification with `count` labels of one box."""
    config: Config = load_config(None, overrides)
    hand = free_hand()
    name = "004_sugar_box"
    objects = {name: free_object(name, config.physics.masses, config.physics.official_compat)}
    return PoolSpec([make_label(hand, name, i) for i in range(count)], hand, objects, config)
