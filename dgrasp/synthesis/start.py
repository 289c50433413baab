"""Hands from which the descent begins: open, in front of an object, with thumb and fingers on opposite sides of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from dgrasp.errors import ConfigError
from dgrasp.geometry.intersection import Body
from dgrasp.objects.free import shape_bounds
from dgrasp.objects.model import ObjectModel
from dgrasp.objects.names import YCB_NAMES
from dgrasp.objects.resting import resting_rotations
from dgrasp.scene.free_rest import PLACE_XY, place_at_rest
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.synthesis.energy import Grasps, unnatural
from dgrasp.synthesis.torch_hand import ObjectField, TorchHand, tensor
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_rotation_vector, transform

LIFT = 0.005
"""m. Largest height of the object above its place at rest at the grasp, as if a hand had just moved it."""
_WIDEST = 0.10
_STEP = 0.002
_TILT = 0.2
"""rad. Standard deviation of the direction between the hand's opposing sides about that between the object's."""
_CANDIDATES = 24
"""Random hands per object pose; the descent begins with the best one."""
_FEWEST, _MOST = 2, 4
"""Smallest and largest number of fingers besides the thumb that should touch, if the hand has as many."""
_TIPS_OPPOSING = 3
"""Number of fingers whose mean tip lies opposite to the thumb's."""
_POWER_SHARE, _PALM_SHARE = 0.5, 0.4
"""Share of hands whose fingers should touch with their middle parts too, and share of these whose palm should."""


@dataclass(frozen=True, eq=False)
class Setting:
    """An object for which grasps are made. body: the surface of its collision shapes in O. field: distance to it."""

    model: ObjectModel
    body: Body
    field: ObjectField


def rest_poses(setting: Setting, rng: np.random.Generator, n: int) -> Array:
    """(n, 4, 4) T_WO of the object at rest on the table, each at a random place and yaw."""
    model = setting.model
    if model.name in YCB_NAMES.values() and _is_primitive(model):
        return place_at_rest(model, rng, n)
    vertices = setting.body.vertices
    downs, share = resting_rotations(vertices, model.center_of_mass_O)
    R = downs[rng.choice(len(downs), size=n, p=share)]
    R = matrix_from_rotation_vector(rng.uniform(-np.pi, np.pi, (n, 1)) * np.array([0.0, 0.0, 1.0])) @ R
    height = TABLE_TOP - (R[:, 2] @ vertices.T).min(axis=1)
    return transform(R, np.concatenate([rng.uniform(*PLACE_XY, (n, 2)), height[:, None]], axis=1))


def _is_primitive(model: ObjectModel) -> bool:
    try:
        shape_bounds(model.shapes)
    except ValueError:
        return False
    return True


def propose(hand: TorchHand, setting: Setting, T_WO: Array, rng: np.random.Generator) -> Grasps:
    """One hand per object pose (B, 4, 4): the best of several random ones.

    The best penetrates object and table least and turns its wrist least beyond the natural range.
    """
    n = len(T_WO) * _CANDIDATES
    R_WO = np.repeat(T_WO[:, :3, :3], _CANDIDATES, axis=0)
    middle, across = _opposite_sides(setting, rng, n)
    motions = _opened(hand, rng, n)
    with torch.no_grad():
        flat = hand.forward(torch.eye(3).expand(n, 3, 3), torch.zeros(n, 3), hand.pose(tensor(motions)))
        tips = hand.tips(flat).numpy().astype(float)
        palm_H = _pad_center(hand)
    tip_of = [hand.layout.tips.index(finger.keypoints[-1]) for finger in (*hand.others[:_TIPS_OPPOSING],
                                                                          hand.layout.fingers[hand.thumb])]
    thumb = tips[:, tip_of[-1]]
    fingers = tips[:, tip_of[:-1]].mean(axis=1) if len(tip_of) > 1 else np.tile(palm_H, (n, 1))
    opposing = _unit(fingers - thumb)
    # What the hand holds lies between thumb and fingers, somewhat towards the palm.
    held = 0.5 * (fingers + thumb)
    held += rng.uniform(0.0, 0.45, (n, 1)) * (palm_H - held)
    ahead = _unit(held - _along(held, opposing))
    across = _unit(across + _TILT * rng.normal(size=(n, 3)))
    towards_O = _approaches(R_WO, across, rng)
    R_OH = _frame(across, towards_O) @ np.swapaxes(_frame(opposing, ahead), 1, 2)
    t_OH = middle - np.matmul(R_OH, held[..., None])[..., 0]
    up = R_WO[:, 2]
    over = np.repeat(T_WO[:, 2, 3] - TABLE_TOP, _CANDIDATES)
    grasps = Grasps(tensor(R_OH), tensor(t_OH), tensor(motions),
                    torch.zeros(n, hand.layout.n_parts, dtype=torch.bool), tensor(up), tensor(over),
                    torch.zeros(n, hand.layout.n_joints, dtype=torch.bool), torch.zeros(n, hand.layout.n_joints))
    with torch.no_grad():
        centers = hand.forward(grasps.R, grasps.t, hand.pose(grasps.motions)).centers
        depth = torch.relu(hand.radii - setting.field.distance(centers)).sum(1)
        sunk = torch.relu(hand.radii - grasps.over[:, None] - (centers @ grasps.up[..., None])[..., 0]).sum(1)
        turned = unnatural(hand, grasps.R, grasps.up).sum(1)
    cost = (depth + 2.0 * sunk + turned).numpy()
    best = cost.reshape(-1, _CANDIDATES).argmin(axis=1) + np.arange(len(T_WO)) * _CANDIDATES
    chosen = grasps.take(torch.as_tensor(best))
    chosen.wanted[:] = torch.as_tensor(_wanted(hand, rng, len(T_WO)))
    return chosen


def _wanted(hand: TorchHand, rng: np.random.Generator, n: int) -> Array:
    """(n, P) bool, the parts that should touch.

    They are the last parts of the thumb and of two to four fingers, often more of each finger, sometimes the palm.
    """
    wanted = np.zeros((n, hand.layout.n_parts), bool)
    wanted[:, hand.thumb_tip] = True
    most = min(_MOST, len(hand.others))
    numbers = range(min(_FEWEST, most), most + 1)
    for row in wanted:
        chosen = hand.others[: numbers[rng.integers(len(numbers))]]
        power = rng.uniform() < _POWER_SHARE
        for finger in chosen:
            row[finger.parts[-1]] = True
            if len(finger.parts) > 1:
                row[finger.parts[-2]] |= power
        row[0] = power and rng.uniform() < _PALM_SHARE
    return wanted


def _opened(hand: TorchHand, rng: np.random.Generator, n: int) -> Array:
    """(n, M) rad: motions drawn from the prior, with all flexions opened by a random angle."""
    prior = hand.motions
    motions = prior.mean + 0.7 * rng.normal(size=(n, len(prior.mean))) @ prior.factor.T
    motions[:, prior.flexions] -= np.radians(rng.uniform(0.0, 25.0, (n, 1)))
    return np.asarray(motions)


def _pad_center(hand: TorchHand) -> Array:
    """(3,) m: a point in front of the palm, in the wrist frame."""
    return np.asarray(0.8 * hand.knuckles + 0.04 * hand.motions.palmar[0])


def _opposite_sides(setting: Setting, rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Middles (n, 3) and directions (n, 3) of chords through the object.

    A chord starts at a random point of the surface and runs along the normal there. It is at most as long as a hand can
    span. Raises `ConfigError` if the object has no such chord.
    """
    vertices, faces = setting.body.surface()
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    drawn = 3 * n
    face = rng.choice(len(faces), size=drawn, p=area / area.sum())
    u, v = np.sqrt(rng.uniform(size=(drawn, 1))), rng.uniform(size=(drawn, 1))
    start = (1.0 - u) * a[face] + u * (1.0 - v) * b[face] + u * v * c[face]
    inwards = -normals[face] / area[face, None]
    lengths = np.arange(_STEP, _WIDEST + _STEP, _STEP)
    with torch.no_grad():
        along = tensor(start)[:, None] + tensor(inwards)[:, None] * tensor(lengths)[None, :, None]
        outside = setting.field.distance(along).numpy() > 0.0
    found = np.flatnonzero(outside[:, 1:].any(axis=1))
    if not len(found):
        raise ConfigError(f"{setting.model.name}: nowhere thinner than {100 * _WIDEST:.0f} cm; a hand cannot span it")
    chosen = found[rng.integers(len(found), size=n)]
    width = lengths[1:][outside[chosen, 1:].argmax(axis=1)]
    return start[chosen] + 0.5 * width[:, None] * inwards[chosen], inwards[chosen]


def _approaches(R_WO: Array, across: Array, rng: np.random.Generator) -> Array:
    """(n, 3) unit vectors in O along which hands approach: level or from above, perpendicular to `across` (n, 3)."""
    n = len(across)
    across_W = np.matmul(R_WO, across[..., None])[..., 0]
    azimuth, down = rng.uniform(-np.pi, np.pi, n), np.arcsin(rng.uniform(-0.1, 1.0, n))
    towards = np.stack([np.cos(down) * np.cos(azimuth), np.cos(down) * np.sin(azimuth), -np.sin(down)], axis=1)
    towards = towards - _along(towards, across_W)
    # The remaining direction may point up.
    towards[towards[:, 2] > 0.1] *= -1.0
    return _unit(np.matmul(np.swapaxes(R_WO, 1, 2), towards[..., None])[..., 0])


def _frame(first: Array, second: Array) -> Array:
    """(n, 3, 3) rotations whose first columns are `first` and whose second ones lie in its plane with `second`."""
    x = _unit(first)
    y = _unit(second - _along(second, x))
    return np.stack([x, y, np.cross(x, y)], axis=2)


def _along(vectors: Array, axes: Array) -> Array:
    return np.asarray((vectors * axes).sum(axis=1, keepdims=True) * axes)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9))
