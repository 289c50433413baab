"""Proposals of free grasps: an object at rest on the table, an open hand before it, and the fingers closed on it.

The wrist stays where it was proposed; each finger joint closes until its finger, from there outwards, would
press deeper into the object than the proposal allows. Everything is computed for many proposals at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dgrasp.hand.free_anatomy import THUMB_PRONATION_DEG, finger_direction
from dgrasp.hand.model import HandModel
from dgrasp.labels.distance import HandSpheres, hand_bottom, part_distances, part_poses, signed_distance
from dgrasp.objects.free import shape_bounds
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.types import Array
from raisim_like.rotations import euler_from_matrix, matrix_from_quaternion, quaternion_from_matrix, transform
from raisim_like.shapes import Shape

TABLE_CLEARANCE = 0.002
"""m between hand and table at the grasp."""
LIFT = 0.005
"""m. At the grasp the object is up to this high above its place at rest, as where a hand has just moved it."""
START_CLEARANCE = 0.03
"""m between hand and object or table at the start: more than the noise of a training reset moves them."""

_LYING_X, _LYING_Y = (math.pi / 2, 0.0, 0.0), (0.0, math.pi / 2, 0.0)
_UPRIGHT = (0.0, 0.0, 0.0)
_REST: dict[str, tuple[tuple[float, float, float], ...]] = {
    "003_cracker_box": (_UPRIGHT, _UPRIGHT, _LYING_Y),
    "004_sugar_box": (_UPRIGHT, _UPRIGHT, _LYING_Y),
    "006_mustard_bottle": (_UPRIGHT, _UPRIGHT, _LYING_X),
    "008_pudding_box": (_UPRIGHT, _UPRIGHT, _LYING_X),
    "009_gelatin_box": (_UPRIGHT, _UPRIGHT, _LYING_X),
    "010_potted_meat_can": (_UPRIGHT, _UPRIGHT, _LYING_Y),
    "021_bleach_cleanser": (_UPRIGHT, _UPRIGHT, _LYING_X),
    "036_wood_block": (_UPRIGHT, _UPRIGHT, _LYING_X),
    "040_large_marker": (_LYING_X,),
    "061_foam_brick": (_UPRIGHT, _LYING_X, _LYING_Y),
}
"""Poses at rest as Euler angles, the frequent ones named twice; objects not named here just stand or lie as in O."""

# Degrees of each closing coordinate: rows open and closed; columns proximal, middle, distal.
_FINGER_LIMIT_DEG = np.array([95.0, 100.0, 75.0])
_THUMB_LIMIT_DEG = np.array([50.0, 45.0, 60.0])


@dataclass
class Proposals:
    """N grasps of one object. T_WO at the grasp; flexion (N, 5, 3) rad closes the joints; side (N, 5) rad turns the
    fingers sideways and, for the thumb, in front of the palm; approach_W (N, 3) is where the palm faces;
    press (N,) m is how deep the fingers may press; speed (N, 3) are the relative speeds of the joints."""

    T_WH: Array
    T_WO: Array
    rest: Array
    approach_W: Array
    flexion: Array
    side: Array
    press: Array
    speed: Array
    bent: Array

    def take(self, rows: Array) -> Proposals:
        """The proposals of these rows."""
        return Proposals(**{name: value[rows] for name, value in vars(self).items()})

    def __len__(self) -> int:
        return len(self.T_WH)


def hand_pose(hand: HandModel, flexion: Array, side: Array, bent: Array) -> Array:
    """(N, 45) joint angles of flexion (N, 5, 3), side (N, 5) and bent (N,), rad: within the limits but for `bent`."""
    n = len(flexion)
    angles = np.zeros((n, 5, 3, 3))
    angles[:, :4, 0, 1] = side[:, :4]
    angles[:, :4, :, 2] = flexion[:, :4]
    bone = finger_direction("thumb")
    to_palm = np.cross(bone, [0.0, -1.0, 0.0])
    to_palm /= np.linalg.norm(to_palm)
    across = np.cross(to_palm, bone)
    pronation = math.radians(THUMB_PRONATION_DEG)
    flex = math.cos(pronation) * to_palm + math.sin(pronation) * across
    opposed = _turn(to_palm, side[:, 4]) @ _turn(across, flexion[:, 4, 0])
    angles[:, 4, 0] = euler_from_matrix(opposed)
    for segment in (1, 2):
        angles[:, 4, segment] = euler_from_matrix(_turn(flex, flexion[:, 4, segment]))
    pose = np.clip(angles.reshape(n, 45), hand.limits[6:, 0], hand.limits[6:, 1])
    pose[:, _DISTAL] -= np.where(flexion[:, :4, 2] < -1.0, bent[:, None], 0.0)
    return pose


_DISTAL = np.array([3 * 3 * finger + 8 for finger in range(4)])


def _turn(axis: Array, angle: Array) -> Array:
    return Rotation.from_rotvec(angle[:, None] * axis).as_matrix()


def place_at_rest(model: ObjectModel, rng: np.random.Generator, n: int) -> Array:
    """(n, 4, 4) T_WO of the object at rest on the table, each at a random place and yaw."""
    downs = [Rotation.from_euler("XYZ", pose).as_matrix() for pose in _REST.get(model.name, (_UPRIGHT,))]
    heights = np.array([TABLE_TOP - lowest(model.shapes, R) for R in downs])
    chosen = rng.integers(len(downs), size=n)
    yaw = Rotation.from_rotvec(rng.uniform(-math.pi, math.pi, n)[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    place = rng.uniform((0.42, 0.10, 0.0), (0.62, 0.35, 0.0), (n, 3))
    place[:, 2] = heights[chosen]
    return transform(yaw @ np.array(downs)[chosen], place)


def lowest(shapes: Sequence[Shape], R_WO: Array) -> float:
    """m: height of the lowest point of primitives above their frame's origin (negative), turned by R_WO."""
    turned = []
    for shape in shapes:
        q = quaternion_from_matrix(R_WO @ matrix_from_quaternion(np.array(shape.quaternion)))
        position = tuple(float(v) for v in R_WO @ np.array(shape.position))
        turned.append(replace(shape, position=position, quaternion=tuple(float(v) for v in q)))
    return float(shape_bounds(turned)[0, 2])


def propose(hand: HandModel, spheres: HandSpheres, model: ObjectModel, rng: np.random.Generator, n: int) -> Proposals:
    """Open hands before the object that touch neither it nor the table: those of n random draws that do not."""
    rest = place_at_rest(model, rng, n)
    T_WO = rest.copy()
    T_WO[:, 2, 3] += rng.uniform(0.0, LIFT, n)
    target_W = _targets(model, T_WO, rng)
    a, fingers = _directions(model, T_WO, rng)
    R_WH = np.stack([-fingers, -a, np.cross(fingers, a)], axis=2)
    held_H = rng.uniform((-0.135, -0.085, 0.0), (-0.075, -0.030, 0.030), (n, 3))
    T_WH = transform(R_WH, target_W - np.matmul(R_WH, held_H[..., None])[..., 0])
    flexion, side = np.zeros((n, 5, 3)), np.zeros((n, 5))
    flexion[:, :4] = np.radians(rng.uniform((-10, 5, 2), (20, 25, 12), (n, 3)))[:, None]
    flexion[:, 4] = np.radians(rng.uniform((-25, -8, -8), (0, 8, 8), (n, 3)))
    side[:, :4] = np.radians(rng.uniform(-0.5, 1.0, n))[:, None] * np.array([5.0, 0.0, -4.0, -8.0]) * -1.0
    side[:, 4] = np.radians(rng.uniform(5, 45, n))
    speed = np.stack([np.ones(n), rng.uniform(0.3, 1.2, n), rng.uniform(0.2, 0.8, n)], axis=1)
    bent = np.where(rng.uniform(size=n) < 0.6, np.radians(rng.uniform(2.0, 8.0, n)), 0.0)
    flexion[bent > 0, :4, 2] = -2.0
    found = Proposals(T_WH, T_WO, rest, a, flexion, side, rng.uniform(0.0005, 0.005, n), speed, bent)
    pose = hand_pose(hand, flexion, side, bent)
    clear = hand_bottom(hand, spheres, T_WH, pose) > TABLE_TOP + TABLE_CLEARANCE
    clear &= R_WH[:, 2, 2] > -0.35
    found, pose = found.take(np.flatnonzero(clear)), pose[clear]
    apart = part_distances(hand, spheres, model.shapes, found.T_WH, pose, found.T_WO).min(axis=1)
    return found.take(np.flatnonzero((apart > 0.0) & (apart < 0.04)))


def _targets(model: ObjectModel, T_WO: Array, rng: np.random.Generator) -> Array:
    """(N, 3) points of the object to hold: near its middle, or in one of its shapes."""
    n = len(T_WO)
    low, high = shape_bounds(model.shapes)
    points = rng.uniform(-0.35, 0.35, (n, 3)) * (high - low)
    weights = np.array([float(np.prod(_half_sizes(s.kind, s.size))) ** (1 / 3) for s in model.shapes])
    chosen = rng.choice(len(model.shapes), size=n, p=weights / weights.sum())
    for i in np.flatnonzero(rng.uniform(size=n) < (0.75 if len(model.shapes) > 1 else 0.0)):
        shape = model.shapes[chosen[i]]
        inside = rng.uniform(-0.7, 0.7, 3) * _half_sizes(shape.kind, shape.size)
        points[i] = matrix_from_quaternion(np.array(shape.quaternion)) @ inside + np.array(shape.position)
    return np.matmul(T_WO[:, :3, :3], points[..., None])[..., 0] + T_WO[:, :3, 3]


def _half_sizes(kind: str, size: tuple[float, ...]) -> Array:
    return np.array(size) / 2 if kind == "box" else np.array([size[0], size[0], size[1] / 2])


def _directions(model: ObjectModel, T_WO: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """(N, 3) unit vectors: where the palm faces, from above or (for tall objects) from the side, and the fingers."""
    n = len(T_WO)
    heights = 2.0 * (T_WO[:, 2, 3] - TABLE_TOP)
    from_side = rng.uniform(size=n) < np.clip((heights - 0.05) / 0.1, 0.0, 0.6)
    down = np.radians(np.where(from_side, rng.uniform(-10, 45, n), rng.uniform(45, 90, n)))
    azimuth = rng.uniform(-math.pi, math.pi, n)
    a = np.stack([np.cos(down) * np.cos(azimuth), np.cos(down) * np.sin(azimuth), -np.sin(down)], axis=1)
    level = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(n)], axis=1)
    steep = np.cross(level, a)
    steep *= -np.sign(steep[:, 2:] + 1e-12)
    turn = np.radians(rng.uniform(-20, 75, n))
    left = rng.choice([-1.0, 1.0], n)
    fingers = (left * np.cos(turn))[:, None] * level + np.sin(turn)[:, None] * steep
    # From straight above every direction of the fingers is as good.
    return a, fingers


def close(hand: HandModel, spheres: HandSpheres, model: ObjectModel, proposals: Proposals) -> None:
    """Close the fingers on the object, in place."""
    limits = np.radians(np.stack([_FINGER_LIMIT_DEG] * 4 + [_THUMB_LIMIT_DEG]))
    moving = spheres.parts > 0
    fingers = HandSpheres(spheres.centers[moving], spheres.radii[moving], spheres.parts[moving])
    for step in (*[3.0] * 34, *[1.0] * 3, *[0.3] * 4):
        for segment in range(3):
            trial = proposals.flexion.copy()
            trial[:, :, segment] += math.radians(step) * proposals.speed[:, None, segment]
            trial = np.minimum(trial, limits)
            if segment == 2:
                trial[proposals.bent > 0, :4, 2] = -2.0
            pose = hand_pose(hand, trial, proposals.side, proposals.bent)
            apart = part_distances(hand, fingers, model.shapes, proposals.T_WH, pose, proposals.T_WO)
            per_finger = apart[:, 1:].reshape(-1, 5, 3)[:, :, segment:].min(axis=2)
            height = _finger_heights(hand, fingers, proposals.T_WH, pose)[:, :, segment:].min(axis=2)
            free = (per_finger > -proposals.press[:, None]) & (height > TABLE_TOP + TABLE_CLEARANCE)
            proposals.flexion[:, :, segment] = np.where(
                free, trial[:, :, segment], proposals.flexion[:, :, segment]
            )


def _finger_heights(hand: HandModel, fingers: HandSpheres, T_WH: Array, pose: Array) -> Array:
    centers = fingers.place(*part_poses(hand, T_WH, pose))
    return fingers.per_part(centers[..., 2])[:, 1:].reshape(-1, 5, 3)


def pressing_normals(
    hand: HandModel, spheres: HandSpheres, model: ObjectModel, proposals: Proposals
) -> tuple[Array, Array]:
    """(N, 16) distances of the parts, and (N, 16, 3) the object's outward normals where they come closest, frame O."""
    pose = hand_pose(hand, proposals.flexion, proposals.side, proposals.bent)
    centers_W = spheres.place(*part_poses(hand, proposals.T_WH, pose))
    T = proposals.T_WO
    centers_O = np.matmul(centers_W - T[:, None, :3, 3], T[:, :3, :3])
    surface = signed_distance(model.shapes, centers_O) - spheres.radii
    n = len(T)
    nearest = np.empty((n, 16, 3))
    distance = np.empty((n, 16))
    for part in range(16):
        mine = np.flatnonzero(spheres.parts == part)
        best = surface[:, mine].argmin(axis=1)
        distance[:, part] = surface[np.arange(n), mine[best]]
        nearest[:, part] = centers_O[np.arange(n), mine[best]]
    step = 1e-4
    gradient = np.stack(
        [
            signed_distance(model.shapes, nearest + step * axis) - signed_distance(model.shapes, nearest - step * axis)
            for axis in np.eye(3)
        ],
        axis=-1,
    )
    norm = np.linalg.norm(gradient, axis=-1, keepdims=True)
    return distance, gradient / np.maximum(norm, 1e-12)
