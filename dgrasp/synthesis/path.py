"""Starts of the approach to synthesised grasps: the wrist drawn back, the fingers opened, nothing in the way."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from dgrasp.hand.layout import N_WRIST
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.synthesis.energy import Grasps
from dgrasp.synthesis.start import Setting
from dgrasp.synthesis.torch_hand import TorchHand, tensor
from dgrasp.types import Array, StartPose
from raisim_like.rotations import matrix_from_euler, transform

DRAWN_BACK = (0.03, 0.08)
"""m between the wrist at the start and at the grasp, as in the recorded labels of the paper (0.03 to 0.06 there)."""
START_CLEARANCE, PATH_CLEARANCE = 0.005, 0.0
"""m. Smallest distance from the hand to object and table, at the start and on the way."""
OPENED_DEG = (15.0, 25.0, 35.0, 45.0)
"""Angles by which all flexions may be opened at the start; the smallest that lets the hand pass is used."""
_START_TURN, _DRAWS = 0.12, 8


@torch.no_grad()
def free_starts(
    hand: TorchHand, setting: Setting, grasps: Grasps, rest: Array, T_WO: Array, rng: np.random.Generator
) -> tuple[list[StartPose], Array]:
    """A start for each grasp, and (N,) bool: whether it and the straight way from it to the grasp are free.

    rest, T_WO (N, 4, 4): the object's poses before and at the grasp. On the way the hand neither turns nor closes, as
    if guidance of the wrist's position alone moved it. On another way, fingers would catch on the object's edges.
    """
    n = len(grasps)
    T_WH = T_WO @ transform(grasps.R.numpy().astype(float), grasps.t.numpy().astype(float))
    # Away from the held object: from the mean of the fingertips to the wrist.
    tips = hand.tips(hand.forward(grasps.R, grasps.t, grasps.pose(hand))).mean(1)
    away = np.matmul(T_WO[:, :3, :3], (grasps.t - tips).numpy()[..., None])[..., 0]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    starts, poses, done = T_WH.copy(), np.zeros((n, hand.layout.n_joints)), np.zeros(n, bool)
    for angle in np.radians(OPENED_DEG):
        pose = hand.clipped(hand.pose(grasps.motions - tensor(angle * hand.motions.flexions)))
        for _ in range(_DRAWS):
            back = away + rng.normal(0.0, 0.25, (n, 3))
            back[:, 2] += rng.uniform(0.0, 0.8, n)
            back *= rng.uniform(*DRAWN_BACK, (n, 1)) / np.linalg.norm(back, axis=1, keepdims=True)
            start = T_WH.copy()
            start[:, :3, 3] += back
            start[:, :3, :3] = start[:, :3, :3] @ matrix_from_euler(rng.uniform(-_START_TURN, _START_TURN, (n, 3)))
            free = ~done & (clearance(hand, setting, rest, start, pose) > START_CLEARANCE)
            for share in (0.25, 0.5, 0.75, 1.0):
                rows = np.flatnonzero(free)
                way = start[rows]
                way[:, :3, 3] -= share * back[rows]
                free[rows] = clearance(hand, setting, rest[rows], way, pose[rows]) > PATH_CLEARANCE
            starts[free], poses[free] = start[free], pose.numpy()[free]
            done |= free
    bent = hand.model.ties.coordinates(np.clip(poses, *hand.model.limits[N_WRIST:].T))
    starts[:, :3, :3] = orthonormal(starts[:, :3, :3])
    return [StartPose(starts[i], rest[i], bent[i]) for i in range(n)], done


def clearance(hand: TorchHand, setting: Setting, T_WO: Array, T_WH: Array, pose: Tensor) -> Array:
    """(N,) m between the hand in `pose` (N, J) and the object or the table, whichever is nearer; negative where they
    overlap."""
    T_OH = np.linalg.inv(T_WO) @ T_WH
    centers = hand.forward(tensor(T_OH[:, :3, :3]), tensor(T_OH[:, :3, 3]), pose).centers
    distance = setting.field.distance(centers) - hand.radii
    up, over = tensor(T_WO[:, 2, :3]), tensor(T_WO[:, 2, 3] - TABLE_TOP)
    height = (centers @ up[..., None])[..., 0] + over[:, None] - hand.radii
    return np.asarray(torch.minimum(distance, height).amin(1).numpy())


def orthonormal(R: Array) -> Array:
    """The rotations nearest to matrices (N, 3, 3) that rounding to float32 has made inexact."""
    u, _, v = np.linalg.svd(R)
    return np.asarray(u @ v)
