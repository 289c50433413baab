"""Target sets: the authors' file, the own set, trajectories, and which label goes where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.errors import DataError
from dgrasp.motion.paths import CIRCLE_LIFT, CIRCLE_RADIUS, PATHS, POUR_ANGLE, POUR_LIFT, sample
from dgrasp.motion.targets import (
    EASY_FILE,
    OOD_ANGLE,
    SET_SIZE,
    TargetSet,
    draw_targets,
    easy_targets,
    near_targets,
    ood_targets,
)
from raisim_like.rotations import matrix_from_euler, rotation_vector, transform
from tests.env.build import random_labels
from tests.reference import reference_or_skip

PERIOD = 0.02886


def test_relative_targets_move_and_turn_the_labels_object_in_the_world() -> None:
    labels = random_labels(3)
    R = Rotation.from_rotvec([0.0, 0.0, np.pi / 2]).as_matrix()
    T = np.stack([np.eye(4), transform(R, np.array([0.1, 0.2, 0.3]))])[:, None]
    placed = TargetSet("some", T, relative=True).place([1, 0, 1], labels)
    assert placed.shape == (3, 1, 4, 4)
    assert np.allclose(placed[1, 0], labels[1].T_WO)
    for i in (0, 2):
        assert np.allclose(placed[i, 0, :3, 3], labels[i].T_WO[:3, 3] + [0.1, 0.2, 0.3])
        assert np.allclose(placed[i, 0, :3, :3], R @ labels[i].T_WO[:3, :3])


def test_absolute_targets_are_the_same_for_every_label() -> None:
    T = transform(np.eye(3), np.array([0.5, 0.0, 0.8]))[None, None]
    placed = TargetSet("some", T, relative=False).place([0, 0], random_labels(2))
    assert np.array_equal(placed, np.concatenate([T, T]))
    placed[0] = 0.0
    assert T.any(), "what is placed is a copy"


def test_the_authors_targets() -> None:
    targets = easy_targets(reference_or_skip() / "labels" / EASY_FILE)
    assert targets.T.shape == (100, 1, 4, 4) and targets.relative
    position = targets.T[:, 0, :3, 3]
    # Lifted by at most 30 cm, at most 20 cm to the sides, turned by at most half a radian about each axis.
    assert np.abs(position[:, :2]).max() < 0.2 and position[:, 2].min() > 0.0 and position[:, 2].max() < 0.3
    angles = Rotation.from_matrix(targets.T[:, 0, :3, :3]).as_euler("XYZ")
    assert angles.min() >= 0.0 and 0.4 < angles.max() <= 0.5


def test_other_pickles_are_refused() -> None:
    labels = reference_or_skip() / "labels" / "contact_opt_train.pkl"
    with pytest.raises(DataError, match="not the authors' motion targets"):
        easy_targets(labels)


def test_the_near_set_lies_where_the_authors_does() -> None:
    targets = near_targets(3)
    assert targets.T.shape == (SET_SIZE, 1, 4, 4) and targets.relative and targets.name == "near"
    assert np.array_equal(targets.T, near_targets(3).T) and not np.array_equal(targets.T, near_targets(4).T)
    position = targets.T[:, 0, :3, 3]
    assert np.abs(position[:, :2]).max() < 0.2 and position[:, 2].min() > 0.0 and position[:, 2].max() < 0.3
    angles = Rotation.from_matrix(targets.T[:, 0, :3, :3]).as_euler("XYZ")
    assert np.abs(angles).max() < 0.5 and angles.min() < -0.4 and angles.max() > 0.4


def test_the_own_set_is_seeded_and_lies_outside_of_the_authors() -> None:
    targets = ood_targets(3)
    assert targets.T.shape == (SET_SIZE, 1, 4, 4) and np.array_equal(targets.T, ood_targets(3).T)
    assert not np.array_equal(targets.T, ood_targets(4).T)
    position, R = targets.T[:, 0, :3, 3], targets.T[:, 0, :3, :3]
    assert ((np.abs(position[:, :2]) > 0.2).any(axis=1) | (position[:, 2] > 0.3)).all()
    angle = np.linalg.norm(rotation_vector(R), axis=1)
    assert angle.min() > OOD_ANGLE[0] and angle.max() < OOD_ANGLE[1]
    # The authors turn by half a radian about each axis at most.
    assert np.linalg.norm(rotation_vector(matrix_from_euler(np.full(3, 0.5)))) < OOD_ANGLE[0]


def test_rounds_use_all_targets_alike() -> None:
    which = draw_targets(10, 7, 3, np.random.default_rng(0))
    assert which.shape == (3, 7)
    # 21 draws of 10 targets: each twice, one of them a third time.
    assert sorted(np.bincount(which.ravel(), minlength=10)) == [2] * 9 + [3]
    assert np.array_equal(which, draw_targets(10, 7, 3, np.random.default_rng(0)))
    assert draw_targets(3, 2, None, np.random.default_rng(0)).tolist() == [[0, 0], [1, 1], [2, 2]]


def test_sampling_is_linear_in_position_and_along_the_arc() -> None:
    T = transform(Rotation.from_rotvec([[0, 0, 0.0], [0, 0, 1.0], [0, 0, 1.0]]).as_matrix(),
                  np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0]]))
    path = sample(np.array([0.2, 1.2, 2.2]), T, 0.1)
    assert path.shape == (22, 4, 4)
    # The end of control step k is at (k + 1) * 0.1 s: still at the start, half way, at the first corner, at the end.
    assert np.allclose(path[0, :3, 3], 0.0) and np.allclose(path[6, :3, 3], [0.5, 0, 0])
    assert np.allclose(rotation_vector(path[6, :3, :3]), [0, 0, 0.5])
    assert np.allclose(path[11, :3, 3], [1, 0, 0]) and np.allclose(path[-1], T[-1])


@pytest.mark.parametrize("name", PATHS)
def test_the_paths_start_and_move_gently(name: str) -> None:
    targets = PATHS[name](PERIOD)
    assert targets.relative and targets.T.shape[0] == 1 and targets.T.shape[1] <= 300
    T = np.concatenate([np.eye(4)[None], targets.T[0]])
    assert np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).max() / PERIOD < 0.2
    turns = rotation_vector(T[1:, :3, :3] @ T[:-1, :3, :3].swapaxes(1, 2))
    assert np.linalg.norm(turns, axis=1).max() / PERIOD < 0.8
    position, end = T[:, :3, 3], T[-1]
    if name == "circle":
        assert np.allclose(end[:3, 3], [0, 0, CIRCLE_LIFT], atol=1e-6) and np.allclose(T[:, :3, :3], np.eye(3))
        up = position[position[:, 2] > CIRCLE_LIFT - 1e-9]
        assert np.linalg.norm(up[:, :2] - [CIRCLE_RADIUS, 0], axis=1) == pytest.approx(CIRCLE_RADIUS, abs=1e-4)
        assert np.ptp(up[:, 1]) == pytest.approx(2 * CIRCLE_RADIUS, abs=1e-3)
    else:
        assert np.allclose(end, transform(np.eye(3), np.array([0, 0, POUR_LIFT])), atol=1e-6)
        assert rotation_vector(T[:, :3, :3])[:, 0].max() == pytest.approx(POUR_ANGLE, abs=1e-3)


def test_placing_keeps_labels_as_they_are() -> None:
    labels = random_labels(2)
    before = [label.T_WO.copy() for label in labels]
    PATHS["pour"](PERIOD).place([0, 0], [replace(label) for label in labels])
    assert all(np.array_equal(label.T_WO, then) for label, then in zip(labels, before, strict=True))
