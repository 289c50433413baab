"""The baseline *+IK: inverse kinematics moves each label's goal contacts onto the object; then PD holds the pose."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Mapping, Sequence

import numpy as np

from dgrasp.env.goal import make_goal
from dgrasp.geometry.intersection import Body
from dgrasp.hand.inverse import fit_keypoints
from dgrasp.hand.model import HandModel
from dgrasp.hand.spheres import CONTACT_DISTANCE
from dgrasp.methods.method import Bodies
from dgrasp.methods.pd import PdBaseline
from dgrasp.objects.body import surface_points
from dgrasp.pool import PoolSpec
from dgrasp.types import Array, GraspLabel

SPACING = 0.003
"""Distance (m) between the sample points of an object's surface."""


class IkBaseline(PdBaseline):
    """*+IK (supplement, section B.4). docs/metrics.md lists the details that the paper leaves open, and our choices."""

    name = "gt_ik"

    def prepare(self, spec: PoolSpec, bodies: Bodies) -> PoolSpec:
        """The specification with corrected labels; prints how long the correction took."""
        objects = bodies()
        started = time.perf_counter()
        labels = correct_labels(spec.labels, spec.hand, objects)
        took = time.perf_counter() - started
        print(f"{self.name}: {len(labels)} labels corrected in {took:.1f} s", file=sys.stderr)
        return dataclasses.replace(spec, labels=labels)


def correct_labels(
    labels: Sequence[GraspLabel], hand: HandModel, objects: Mapping[str, Body]
) -> list[GraspLabel]:
    """Fit the hands so that the key points of goal contacts reach the closest points of their object's surface.

    The targets of the other key points are their present positions. A small penalty keeps the finger angles near the
    label's (`fit_keypoints`). Wrist and fingers move; the object does not.
    objects: bodies by name, in their frames O.
    """
    joints_O = make_goal(labels).joints_O
    closest = closest_points(labels, joints_O, objects)
    goal_contacts = np.array([label.goal_contacts for label in labels], dtype=bool)
    distances = np.linalg.norm(closest - joints_O, axis=2)
    touching = contact_keypoints(hand.chain.keypoint_parts, goal_contacts, distances)
    targets = np.where(touching[..., None], closest, joints_O)
    T_WO = np.array([label.T_WO for label in labels])
    T_OH = np.linalg.inv(T_WO) @ np.array([label.T_WH for label in labels])
    fit = fit_keypoints(hand, T_OH, np.array([label.hand_pose for label in labels]), targets)
    T_WH = T_WO @ fit.T_AH
    joints_W = np.matmul(fit.joints, np.swapaxes(T_WO[:, :3, :3], 1, 2)) + T_WO[:, None, :3, 3]
    return [
        dataclasses.replace(label, hand_pose=fit.hand_pose[i], T_WH=T_WH[i], joints_W=joints_W[i])
        for i, label in enumerate(labels)
    ]


def closest_points(labels: Sequence[GraspLabel], joints_O: Array, objects: Mapping[str, Body]) -> Array:
    """(N, K, 3) m, in O: for each key point (N, K, 3) the closest surface point of its label's object.

    The candidates are sample points of the surface, `SPACING` apart.
    """
    from scipy.spatial import cKDTree

    closest = np.empty_like(joints_O)
    names = np.array([label.object_id for label in labels])
    for name in dict.fromkeys(names.tolist()):
        mine = np.flatnonzero(names == name)
        points = surface_points(objects[name], SPACING)
        closest[mine] = points[cKDTree(points).query(joints_O[mine])[1]]
    return closest


def contact_keypoints(keypoint_parts: Array, goal_contacts: Array, distances: Array) -> Array:
    """(N, K) bool: the key points that represent the goal contacts (N, P), given distances (N, K) m to the object.

    keypoint_parts: (K,) the part that each key point belongs to. A finger part has the key point of its joint; the last
    part of a finger also has the fingertip. Of a part with a goal contact, the key points within 0.015 m of the object
    are chosen, the distance with which the authors' labels were made. If none is so near, the closest is chosen. The
    palm (part 0) has none, because its key point, the wrist, is not where a palm touches.
    """
    chosen = np.zeros(distances.shape, bool)
    for part in range(1, goal_contacts.shape[1]):
        own = np.flatnonzero(keypoint_parts == part)
        near = distances[:, own] <= CONTACT_DISTANCE
        nearest = distances[:, own] == distances[:, own].min(axis=1, keepdims=True)
        chosen[:, own] = goal_contacts[:, part, None] & (near | (nearest & ~near.any(axis=1, keepdims=True)))
    return chosen
