"""Proposals of free grasps: an open hand before an object at rest on the table, and its fingers closed.

The wrist stays where it was proposed; each joint closes until its finger, from there outwards, would press
deeper into the object than the proposal allows. Everything is computed for many proposals at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dgrasp.hand.free_anatomy import THUMB_PRONATION_DEG, finger_direction
from dgrasp.hand.model import HandModel
from dgrasp.hand.skeleton import N_PARTS
from dgrasp.labels.distance import HandSpheres, hand_bottom, part_distances, part_poses, signed_distance
from dgrasp.labels.free_rest import place_at_rest
from dgrasp.objects.free import shape_bounds
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.types import Array
from raisim_like.rotations import euler_from_matrix, matrix_from_quaternion, rotate, transform

TABLE_CLEARANCE = 0.002
"""m between hand and table at the grasp."""
LIFT = 0.005
"""m. At the grasp the object is up to this high above its place at rest, as where a hand has just moved it."""
TOUCHING = 0.001
"""m. A part this close to the object touches it."""
MIN_OPPOSED = 0.2
"""Least cosine between the thumb's push and that of the fingers, reversed."""

BENT_SHARE, BENT_DEG = 0.4, (2.0, 8.0)
SPREAD_SHARE, SPREAD_DEG = 0.6, (2.0, 8.0)
"""Share of the grasps whose fingertips are bent back, and whose thumb is spread, by the object that they press on,
and by how much beyond the joint's own range.

Soft hands yield like that in life, and recorded grasps leave the joint limits too. A controller that is limited
to the range pulls such a joint back and so closes the hand: the grasp may hold without learning."""

_CLOSED_DEG = np.array([[95.0, 100.0, 75.0]] * 4 + [[50.0, 45.0, 60.0]])
"""Per finger and joint, the most that closing turns it."""
_DISTAL_Z = np.array([9 * finger + 8 for finger in range(4)])
_THUMB_Y = 37
_THUMB_SPREAD = math.radians(-26.0)
_STEPS_DEG = (*[4.0] * 25, *[1.0] * 4, *[0.3] * 4)


@dataclass
class Grasps:
    """N grasps of one object; world frame, m, rad.

    T_WH, T_WO (N, 4, 4): at the grasp. T_WO_rest (N, 4, 4): before it. approach_W (N, 3): where the palm faces.
    flexion, open_flexion (N, 5, 3): how far each joint is closed, at the grasp and before. side (N, 5): the
    fingers' spread, and how far the thumb stands before the palm. bent, spread (N,): how far the four fingertips
    and the thumb's base are beyond their ranges, 0 for within. press (N,): how deep fingers may press.
    speed (N, 3): relative speeds of the joints.
    """

    T_WH: Array
    T_WO: Array
    T_WO_rest: Array
    approach_W: Array
    flexion: Array
    open_flexion: Array
    side: Array
    bent: Array
    spread: Array
    press: Array
    speed: Array

    def take(self, rows: Array) -> Grasps:
        """The grasps of these rows (indices or a mask)."""
        return Grasps(**{name: value[rows] for name, value in vars(self).items()})

    def __len__(self) -> int:
        return len(self.T_WH)


def join(parts: list[Grasps]) -> Grasps:
    """All grasps in one."""
    return Grasps(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])})


def angles_of(hand: HandModel, grasps: Grasps) -> Array:
    """(N, 45) joint angles at the grasps."""
    return finger_angles(hand, grasps.flexion, grasps.side, grasps.bent, grasps.spread)


def finger_angles(hand: HandModel, flexion: Array, side: Array, bent: Array, spread: Array) -> Array:
    """(N, 45) joint angles of flexion (N, 5, 3), side (N, 5), bent and spread (N,), which alone leave the limits."""
    n = len(flexion)
    angles = np.zeros((n, 5, 3, 3))
    angles[:, :4, 0, 1] = side[:, :4]
    angles[:, :4, :, 2] = flexion[:, :4]
    bone = finger_direction("thumb")
    to_palm = np.cross(bone, [0.0, -1.0, 0.0])
    to_palm /= np.linalg.norm(to_palm)
    across = np.cross(to_palm, bone)
    pronation = math.radians(THUMB_PRONATION_DEG)
    outer = math.cos(pronation) * to_palm + math.sin(pronation) * across
    angles[:, 4, 0] = euler_from_matrix(_turn(to_palm, side[:, 4]) @ _turn(across, flexion[:, 4, 0]))
    for segment in (1, 2):
        angles[:, 4, segment] = euler_from_matrix(_turn(outer, flexion[:, 4, segment]))
    lower, upper = hand.limits[6:].T
    pose = np.clip(angles.reshape(n, 45), lower, upper)
    pose[:, _DISTAL_Z] = np.where(bent[:, None] > 0, lower[_DISTAL_Z] - bent[:, None], pose[:, _DISTAL_Z])
    pose[:, _THUMB_Y] = np.where(spread > 0, upper[_THUMB_Y] + spread, pose[:, _THUMB_Y])
    return pose


def _turn(axis: Array, angle: Array) -> Array:
    return Rotation.from_rotvec(angle[:, None] * axis).as_matrix()


def propose(hand: HandModel, spheres: HandSpheres, model: ObjectModel, rng: np.random.Generator, n: int) -> Grasps:
    """Open hands close before the object, clear of it and of the table: those of n random draws that are."""
    rest = place_at_rest(model, rng, n)
    T_WO = rest.copy()
    T_WO[:, 2, 3] += rng.uniform(0.0, LIFT, n)
    target_W = _targets(model, T_WO, rng)
    approach, fingers = _directions(2.0 * (rest[:, 2, 3] - TABLE_TOP), rng)
    # Columns: the wrist's axes. Fingers point along -x, the palm faces -y.
    R_WH = np.stack([-fingers, -approach, np.cross(fingers, approach)], axis=2)
    held_H = rng.uniform((-0.135, -0.085, 0.0), (-0.075, -0.030, 0.030), (n, 3))
    flexion, side = np.empty((n, 5, 3)), np.empty((n, 5))
    flexion[:, :4] = np.radians(rng.uniform((-10, 5, 2), (20, 25, 12), (n, 3)))[:, None]
    flexion[:, 4] = np.radians(rng.uniform((-25, -8, -8), (0, 8, 8), (n, 3)))
    side[:, :4] = np.radians(rng.uniform(-0.5, 1.0, n))[:, None] * [-5.0, 0.0, 4.0, 8.0]
    side[:, 4] = np.radians(rng.uniform(5, 45, n))
    bent = np.where(rng.uniform(size=n) < BENT_SHARE, np.radians(rng.uniform(*BENT_DEG, n)), 0.0)
    spread = np.where(rng.uniform(size=n) < SPREAD_SHARE, np.radians(rng.uniform(*SPREAD_DEG, n)), 0.0)
    flexion[spread > 0, 4, 0] = _THUMB_SPREAD
    speed = np.stack([np.ones(n), rng.uniform(0.3, 1.2, n), rng.uniform(0.2, 0.8, n)], axis=1)
    grasps = Grasps(
        transform(R_WH, target_W - rotate(R_WH, held_H)), T_WO, rest, approach, flexion, flexion.copy(), side, bent,
        spread, rng.uniform(0.0005, 0.005, n), speed,
    )  # fmt: skip
    # The thumb's side of the hand does not point down: nobody's arm turns like that at a table.
    grasps = grasps.take(R_WH[:, 2, 2] > -0.35)
    pose = angles_of(hand, grasps)
    above = hand_bottom(hand, spheres, grasps.T_WH, pose) > TABLE_TOP + TABLE_CLEARANCE
    grasps, pose = grasps.take(above), pose[above]
    coarse = spheres.take(np.arange(len(spheres.parts)) % 6 == 0)
    apart = part_distances(hand, coarse, model.shapes, grasps.T_WH, pose, grasps.T_WO).min(axis=1)
    grasps, pose = grasps.take(apart > 0.0), pose[apart > 0.0]
    apart = part_distances(hand, spheres, model.shapes, grasps.T_WH, pose, grasps.T_WO).min(axis=1)
    return grasps.take((apart > 0.0) & (apart < 0.04))


def _targets(model: ObjectModel, T_WO: Array, rng: np.random.Generator) -> Array:
    """(N, 3) points to hold: near the object's middle, or in one of its shapes."""
    n = len(T_WO)
    low, high = shape_bounds(model.shapes)
    points = rng.uniform(-0.35, 0.35, (n, 3)) * (high - low)
    halves = [np.array(s.size) / 2 if s.kind == "box" else np.array([s.size[0], s.size[0], s.size[1] / 2])
              for s in model.shapes]  # fmt: skip
    weights = np.array([float(np.prod(half)) ** (1 / 3) for half in halves])
    chosen = rng.choice(len(halves), size=n, p=weights / weights.sum())
    inside = rng.uniform(-0.7, 0.7, (n, 3))
    in_shape = rng.uniform(size=n) < (0.75 if len(halves) > 1 else 0.0)
    for k, shape in enumerate(model.shapes):
        mine = in_shape & (chosen == k)
        R = matrix_from_quaternion(np.array(shape.quaternion))
        points[mine] = (inside[mine] * halves[k]) @ R.T + np.array(shape.position)
    return rotate(T_WO[:, :3, :3], points) + T_WO[:, :3, 3]


def _directions(heights: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """(N, 3) unit vectors, where the palm faces and where the fingers point, for objects of heights (N,) m.

    The hand comes from above, and to tall objects also from the side; its fingers point to the side or down.
    """
    n = len(heights)
    from_side = rng.uniform(size=n) < np.clip((heights - 0.05) / 0.1, 0.0, 0.6)
    down = np.radians(np.where(from_side, rng.uniform(-10, 45, n), rng.uniform(45, 90, n)))
    azimuth = rng.uniform(-math.pi, math.pi, n)
    ahead = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(n)], axis=1)
    approach = np.cos(down)[:, None] * ahead - np.sin(down)[:, None] * [0.0, 0.0, 1.0]
    level = np.cross([0.0, 0.0, 1.0], ahead)
    steep = -np.sin(down)[:, None] * ahead - np.cos(down)[:, None] * [0.0, 0.0, 1.0]
    turn = np.radians(rng.uniform(-20, 75, n))
    sign = rng.choice([-1.0, 1.0], n)
    return approach, (sign * np.cos(turn))[:, None] * level + np.sin(turn)[:, None] * steep


def close(hand: HandModel, spheres: HandSpheres, model: ObjectModel, grasps: Grasps) -> None:
    """Close the fingers on the object, in place."""
    # A joint moves the parts from its own outwards.
    outwards = [spheres.take((spheres.parts > 0) & ((spheres.parts - 1) % 3 >= segment)) for segment in range(3)]
    for step in _STEPS_DEG:
        for segment in range(3):
            trial = grasps.flexion.copy()
            trial[:, :, segment] += math.radians(step) * grasps.speed[:, None, segment]
            trial = np.minimum(trial, np.radians(_CLOSED_DEG))
            trial[grasps.spread > 0, 4, 0] = _THUMB_SPREAD
            pose = finger_angles(hand, trial, grasps.side, grasps.bent, grasps.spread)
            moved = outwards[segment]
            centers_W = moved.place(*part_poses(hand, grasps.T_WH, pose))
            centers_O = np.matmul(centers_W - grasps.T_WO[:, None, :3, 3], grasps.T_WO[:, :3, :3])
            height = _lowest_of_fingers(moved.per_part(centers_W[..., 2]))
            apart = _lowest_of_fingers(moved.per_part(signed_distance(model.shapes, centers_O)))
            free = (apart > -grasps.press[:, None]) & (height > TABLE_TOP + TABLE_CLEARANCE)
            grasps.flexion[:, :, segment] = np.where(free, trial[:, :, segment], grasps.flexion[:, :, segment])


def _lowest_of_fingers(per_part: Array) -> Array:
    """(N, 5) least value of each finger's parts, from (N, 16)."""
    lowest: Array = per_part[:, 1:].reshape(-1, 5, 3).min(axis=2)
    return lowest


def grip_quality(hand: HandModel, spheres: HandSpheres, model: ObjectModel, grasps: Grasps) -> Array:
    """(N,) how promising the grasps are; -inf without the thumb and two fingers on opposite sides of the object.

    Counted are how well thumb and fingers oppose each other, how far bent fingertips would move into the object
    against the thumb, in mm, and parts that carry the object from below.
    """
    distance, normal_W = _nearest(hand, spheres, model, grasps)
    touching: Array = distance < TOUCHING
    per_finger = np.asarray(touching[:, 1:].reshape(-1, 5, 3).any(axis=2))
    thumb = np.take_along_axis(normal_W, 13 + distance[:, 13:].argmin(axis=1)[:, None, None], axis=1)[:, 0]
    fingers = (normal_W[:, 1:13] * touching[:, 1:13, None]).sum(axis=1)
    fingers /= np.maximum(np.linalg.norm(fingers, axis=1, keepdims=True), 1e-9)
    opposed = -(fingers * thumb).sum(axis=1)
    at_limit = replace(grasps, bent=np.minimum(grasps.bent, 1e-9), spread=np.minimum(grasps.spread, 1e-9))
    pulled_in = angles_of(hand, at_limit)
    after = part_distances(hand, spheres, model.shapes, grasps.T_WH, pulled_in, grasps.T_WO)
    squeeze = 1000.0 * np.clip(np.minimum(distance, 0.0) - after, 0.0, 0.002)[:, :, None] * normal_W
    grip = -squeeze[:, 1:13].sum(axis=1) * thumb - squeeze[:, 13:].sum(axis=1) * fingers
    carried = np.where(touching, -normal_W[:, :, 2], 0.0).max(axis=1)
    quality = opposed + grip.sum(axis=1) + np.clip(carried, 0.0, 0.7)
    sound = per_finger[:, 4] & (per_finger[:, :4].sum(axis=1) >= 2) & (opposed > MIN_OPPOSED)
    return np.where(sound, quality, -np.inf)


def _nearest(hand: HandModel, spheres: HandSpheres, model: ObjectModel, grasps: Grasps) -> tuple[Array, Array]:
    """(N, 16) distances of the parts, and (N, 16, 3) the object's outward normals where they are nearest, world."""
    pose = angles_of(hand, grasps)
    centers_W = spheres.place(*part_poses(hand, grasps.T_WH, pose))
    R_WO = grasps.T_WO[:, :3, :3]
    centers_O = np.matmul(centers_W - grasps.T_WO[:, None, :3, 3], R_WO)
    surface = signed_distance(model.shapes, centers_O) - spheres.radii
    nearest = np.empty((len(grasps), N_PARTS, 3))
    for part in range(N_PARTS):
        mine = np.flatnonzero(spheres.parts == part)
        best = mine[surface[:, mine].argmin(axis=1)]
        nearest[:, part] = centers_O[np.arange(len(grasps)), best]
    h = 1e-4
    slopes = [signed_distance(model.shapes, nearest + h * e) - signed_distance(model.shapes, nearest - h * e)
              for e in np.eye(3)]  # fmt: skip
    normal_O = np.stack(slopes, axis=-1)
    normal_O /= np.maximum(np.linalg.norm(normal_O, axis=-1, keepdims=True), 1e-12)
    return spheres.per_part(signed_distance(model.shapes, centers_O)), rotate(R_WO[:, None], normal_O)
