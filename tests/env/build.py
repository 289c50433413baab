"""States, goals and environments made by hand for the tests of this folder."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dgrasp.config.experiment import Config, load_config
from dgrasp.env.features import FeatureLayer
from dgrasp.env.goal import make_goal
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.hand.model import HandModel
from dgrasp.objects.free import free_object
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.relations import relations
from dgrasp.scene.state import state_views
from dgrasp.types import Array, GraspGoal, GraspLabel, SceneState, StartPose
from raisim_like.rotations import transform
from tests import scenes
from tests.scenes import LAYOUT


@cache
def hand() -> HandModel:
    """The hand that ships, read once."""
    return scenes.free_hand()


@cache
def box(name: str = "004_sugar_box") -> ObjectModel:
    """A free object with the authors' mass properties."""
    return free_object(name, "official", True)


def label(index: int = 0, **changes: Any) -> GraspLabel:
    """An open hand above a box on the table; it holds nothing."""
    return replace(scenes.make_label(hand(), index=index), **changes)


def make_env(count: int = 1, first: int = 0, overrides: list[str] | None = None, **options: Any) -> GraspEnv:
    """An environment with the labels `first` to `first + count - 1`."""
    labels = [label(first + i) for i in range(count)]
    config: Config = load_config(None, overrides)
    return GraspEnv(labels, hand(), {"004_sugar_box": box()}, config, indices=range(first, first + count), **options)


def actions(count: int, step: int, first: int = 0) -> Array:
    """(count, 51) float32 random actions, which do not depend on an environment's place in the set."""
    return np.array(
        [np.random.default_rng([step, first + i]).normal(size=51) for i in range(count)], dtype=np.float32
    )


def random_rotations(n: int, rng: np.random.Generator, largest: float = 1.2) -> Array:
    """(n, 3, 3) rotations by at most `largest` rad, so that Euler angles stay clear of their jumps."""
    axes = rng.normal(size=(n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return Rotation.from_rotvec(axes * rng.uniform(0, largest, (n, 1))).as_matrix()


def random_state(n: int, seed: int = 0) -> SceneState:
    """N states with random numbers, in which hand and key points agree."""
    rng = np.random.default_rng(seed)
    s = state_views(n, LAYOUT)
    s.gc[:] = rng.uniform(-0.4, 0.4, (n, 51))
    s.gv[:] = rng.normal(size=(n, 51))
    s.R_WH0[:] = random_rotations(n, rng, 0.5)
    s.wrist_start_W[:] = rng.normal(size=(n, 3))
    s.R_WH[:], s.joints_W[:] = hand().forward(s.gc, s.R_WH0, s.wrist_start_W)
    s.R_WO[:] = random_rotations(n, rng, 0.5)
    s.object_pos_W[:] = rng.normal(size=(n, 3))
    s.object_linvel_W[:] = rng.normal(size=(n, 3))
    s.object_angvel_W[:] = rng.normal(size=(n, 3))
    s.contacts[:] = rng.random((n, 16)) < 0.5
    s.contact_impulse[:] = s.contacts * rng.uniform(0, 0.1, (n, 16))
    s.object_start_W[:] = rng.normal(size=(n, 3))
    s.table_height_W[:] = rng.uniform(0.2, 0.6, n)
    s.object_mass[:] = rng.uniform(0.1, 1.0, n)
    s.R_WG[:] = random_rotations(n, rng, 0.5)
    s.target_pos_W[:] = rng.normal(size=(n, 3))
    return s


def random_labels(n: int, seed: int = 1) -> list[GraspLabel]:
    """N labels with hands and objects in random poses."""
    rng = np.random.default_rng(seed)
    made = []
    for i in range(n):
        pose = rng.uniform(-0.4, 0.4, 45)
        T_WH = transform(random_rotations(1, rng, 0.5)[0], rng.normal(size=3))
        T_WO = transform(random_rotations(1, rng, 0.5)[0], rng.normal(size=3))
        gc = np.concatenate([np.zeros(6), pose])[None]
        joints = hand().forward(gc, T_WH[None, :3, :3], T_WH[None, :3, 3])[1][0]
        made.append(GraspLabel("004_sugar_box", pose, T_WH, T_WO, joints, rng.random(16) < 0.5,
                               StartPose(T_WH, T_WO, pose), "free", "test", i))
    return made


def state_at(labels: list[GraspLabel]) -> SceneState:
    """The states in which every label is reached: H0 is the label's wrist; the object has the label's pose."""
    s = state_views(len(labels), LAYOUT)
    s.gc[:, 6:] = [one.hand_pose for one in labels]
    s.R_WH0[:] = s.R_WH[:] = [one.T_WH[:3, :3] for one in labels]
    s.wrist_start_W[:] = [one.T_WH[:3, 3] for one in labels]
    s.joints_W[:] = [one.joints_W for one in labels]
    s.R_WO[:] = [one.T_WO[:3, :3] for one in labels]
    s.object_pos_W[:] = s.object_start_W[:] = [one.T_WO[:3, 3] for one in labels]
    s.table_height_W[:] = 0.5
    s.object_mass[:] = 1.0
    return s


def copy_state(state: SceneState) -> SceneState:
    """A deep copy."""
    return SceneState(**{f.name: getattr(state, f.name).copy() for f in fields(state)})


def moved_state(state: SceneState, T: Array) -> SceneState:
    """The same scene after the rigid motion T (4, 4) of the world; gc and gv, relative to H0, do not change."""
    R, t = T[:3, :3], T[:3, 3]
    s = copy_state(state)
    for name in ("R_WH0", "R_WH", "R_WO", "R_WG"):
        setattr(s, name, R @ getattr(state, name))
    for name in ("wrist_start_W", "joints_W", "object_pos_W", "object_start_W", "target_pos_W"):
        setattr(s, name, getattr(state, name) @ R.T + t)
    for name in ("object_linvel_W", "object_angvel_W"):
        setattr(s, name, getattr(state, name) @ R.T)
    return s


def moved_label(one: GraspLabel, T: Array) -> GraspLabel:
    """The label after the rigid motion T of the world."""
    start = None if one.start is None else replace(one.start, T_WH=T @ one.start.T_WH, T_WO=T @ one.start.T_WO)
    joints = one.joints_W @ T[:3, :3].T + T[:3, 3]
    return replace(one, T_WH=T @ one.T_WH, T_WO=T @ one.T_WO, joints_W=joints, start=start)


def yaw_and_shift(yaw: float, x: float, y: float) -> Array:
    """(4, 4): a turn about the vertical and a horizontal shift."""
    return transform(Rotation.from_rotvec([0, 0, yaw]).as_matrix(), np.array([x, y, 0.0]))


def observe(layer: FeatureLayer, state: SceneState, goal: GraspGoal) -> Array:
    """(N, size) float64 observation."""
    out = np.zeros((len(state.gc), layer.size))
    layer(state, goal, relations(state, goal), out)
    return out


def goals(n: int, seed: int = 1) -> GraspGoal:
    """The goals of `random_labels`."""
    return make_goal(random_labels(n, seed))
