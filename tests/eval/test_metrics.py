from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.errors import DataError
from dgrasp.eval.metrics import (
    contact_ratio,
    geodesic_errors_rad,
    geodesic_rad,
    grasp_pose,
    label_angles_deg,
    label_distance_mm,
    mpe_m,
    position_errors_m,
    recorded_window,
    sim_dist_mm_per_s,
    sim_dist_mm_per_step,
    sim_dist_wrist_mm_per_step,
    success,
)
from dgrasp.types import Array, EpisodeRecord
from tests.eval.records import DT, at, label, record

STEPS = 10
WINDOW = STEPS * DT


@pytest.mark.parametrize(("window_s", "steps"), [(5.0, 173), (3.87, 134), (DT, 1), (0.6 * DT, 1), (10.4 * DT, 10)])
def test_window_is_rounded_to_control_steps(window_s: float, steps: int) -> None:
    # 5 / 0.02886 = 173.25; 3.87 / 0.02886 = 134.1.
    assert recorded_window(record(at(np.full(240, 0.6)), window_start=60), window_s) == steps


def test_record_that_ends_before_the_window() -> None:
    episode = record(at(np.full(60 + 172, 0.6)), window_start=60)
    for metric in (success, sim_dist_mm_per_step):
        with pytest.raises(DataError, match=r"test:004_sugar_box\[0\]: 172 control steps .* needs 173"):
            metric(episode, 5.0)
    with pytest.raises(DataError, match="no control step"):
        success(episode, 0.4 * DT)
    with pytest.raises(DataError, match=": 0 control steps"):
        success(record(at([0.6]), window_start=60), 5.0)


def test_a_held_object_succeeds() -> None:
    episode = record(at(np.full(STEPS + 5, 0.6)), window_start=5)
    assert success(episode, WINDOW)
    assert sim_dist_mm_per_step(episode, WINDOW) == 0.0


@pytest.mark.parametrize(("step", "held"), [(4, True), (5, False), (9, False), (14, False), (15, True)])
def test_touching_the_table_counts_within_the_window_alone(step: int, held: bool) -> None:
    # The window is steps 5 to 14.
    table = np.arange(20) == step
    assert success(record(at(np.full(20, 0.6)), window_start=5, table=table), WINDOW) is held


@pytest.mark.parametrize(
    ("height", "held"), [(0.1001, True), (0.1, False), (0.0, False), (-5.0, False), (np.nan, False)]
)
def test_falling_past_the_table(height: float, held: bool) -> None:
    heights = np.full(15, 0.6)
    heights[14] = height
    assert success(record(at(heights), window_start=5), WINDOW) is held


def test_an_episode_that_ended_early_fails() -> None:
    full = record(at(np.full(15, 0.6)), window_start=5, terminated="NaN")
    assert not success(full, WINDOW)
    cut = record(at([0.6] * 5 + [0.61, 0.62, np.nan]), window_start=5, terminated="NaN")
    assert not success(cut, WINDOW)
    # Two valid steps of 10 mm; the broken one is left out.
    assert sim_dist_mm_per_step(cut, WINDOW) == pytest.approx(10.0)
    before = record(at([0.6, np.nan]), window_start=5, terminated="NaN")
    assert not success(before, WINDOW)
    assert sim_dist_mm_per_step(before, WINDOW) is None
    assert sim_dist_mm_per_s(before, WINDOW) is None


def test_sim_dist_by_hand() -> None:
    # Before the window the object moves 1 m per step, which does not count; then 3-4-5 mm steps, then rest.
    x = [[0, 0, 2.0], [0, 0, 1.0], [0.003, 0.004, 1.0], [0.006, 0.008, 1.0], [0.006, 0.008, 1.0], [9.0, 9.0, 1.0]]
    episode = record(x, window_start=2)
    assert sim_dist_mm_per_step(episode, 3 * DT) == pytest.approx((5.0 + 5.0 + 0.0) / 3)
    assert sim_dist_mm_per_s(episode, 3 * DT) == pytest.approx(10.0 / 3 / 0.02886)


def test_a_record_that_begins_with_the_window() -> None:
    # Without a state before the window, its ten states give nine displacements of 2 mm.
    episode = record(at(1.0 - 0.002 * np.arange(STEPS)), window_start=0)
    assert sim_dist_mm_per_step(episode, WINDOW) == pytest.approx(2.0)
    assert sim_dist_mm_per_step(record(at([1.0]), window_start=0), DT) is None


def test_a_can_in_free_fall_scores_24_mm_per_step() -> None:
    # Released at rest, z = h - g t^2 / 2; after six steps the can has fallen 147 mm and touches the table. The mean
    # step is g dt^2 6 / 2 = 24.5 mm, which would be very slow in mm/s. The steps at rest after the fall do not count.
    t = np.arange(STEPS + 1) * DT
    fall = 0.5 - 0.5 * 9.81 * np.minimum(t, 6 * DT) ** 2
    table = np.arange(STEPS + 1) >= 6
    episode = record(at(fall), window_start=1, table=table)
    expected = 1000 * 9.81 * DT**2 * 3
    assert expected == pytest.approx(24.5, abs=0.05)
    assert sim_dist_mm_per_step(episode, WINDOW) == pytest.approx(expected)
    assert sim_dist_mm_per_s(episode, WINDOW) == pytest.approx(expected / DT)
    assert not success(episode, WINDOW)


def test_sim_dist_stops_where_the_object_falls_past_the_table() -> None:
    episode = record(at([0.3, 0.2, 0.1, -0.9, -1.9]), window_start=1)
    assert sim_dist_mm_per_step(episode, 4 * DT) == pytest.approx(100.0)


def test_contact_with_the_table_before_the_window_does_not_stop_it() -> None:
    episode = record(at([0.5, 0.5, 0.49, 0.48]), window_start=2, table=[True, True, False, False])
    assert sim_dist_mm_per_step(episode, 2 * DT) == pytest.approx(10.0)


def test_sim_dist_is_the_same_in_every_world_frame() -> None:
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.normal(0.0, 0.001, (20, 3)), axis=0) + np.array([0.0, 0.0, 1.0])
    rotation = Rotation.from_euler("z", 1.1).as_matrix()
    one = sim_dist_mm_per_step(record(x, window_start=5), WINDOW)
    two = sim_dist_mm_per_step(record(x @ rotation.T + [3.0, 4.0, 0.0], window_start=5), WINDOW)
    assert one == pytest.approx(two)


def test_sim_dist_to_the_wrist() -> None:
    # Hand and object move together, and the hand turns about the object's position: the object does not move in the
    # wrist frame.
    n = 12
    T_WH = np.tile(np.eye(4), (n, 1, 1))
    T_WH[:, :3, :3] = Rotation.from_euler("y", 0.1 * np.arange(n)[:, None]).as_matrix()
    T_WH[:, :3, 3] = at(0.5 + 0.01 * np.arange(n))
    x = T_WH[:, :3, 3] + np.einsum("tij,j->ti", T_WH[:, :3, :3], [0.1, 0.0, 0.0])
    held = record(x, window_start=2, T_WH=T_WH)
    assert sim_dist_wrist_mm_per_step(held, WINDOW) == pytest.approx(0.0, abs=1e-9)
    assert sim_dist_mm_per_step(held, WINDOW) > 5.0  # type: ignore[operator]
    # The object stays in the world, and the hand moves away in a straight line by 10 mm per step.
    T_WH[:, :3, :3] = Rotation.from_euler("x", 0.7).as_matrix()
    left = record(at(np.full(n, 0.6)), window_start=2, T_WH=T_WH)
    assert sim_dist_wrist_mm_per_step(left, WINDOW) == pytest.approx(10.0)


def test_broken_states_of_an_episode_that_did_not_end_are_an_error() -> None:
    x = at(np.full(15, 0.6))
    x[8, 0] = np.nan
    with pytest.raises(DataError, match=r"test:004_sugar_box\[0\]: NaN"):
        sim_dist_mm_per_step(record(x, window_start=5), WINDOW)


def targeted(T_WO: Array, T_WG: Array, window_start: int = 0) -> EpisodeRecord:
    """An episode with the object's poses and its target: (T, 4, 4), or (4, 4) for a constant target."""
    made = record(np.zeros((len(T_WO), 3)), window_start=window_start)
    return replace(made, T_WO=T_WO, T_WG=np.broadcast_to(T_WG, T_WO.shape))


def test_a_record_has_a_target_for_each_step() -> None:
    made = record(np.zeros((3, 3)))
    assert replace(made, T_WG=np.tile(np.eye(4), (3, 1, 1))).T_WG is not None
    for wrong in (np.eye(4), np.tile(np.eye(4), (4, 1, 1)), np.zeros((3, 3))):
        with pytest.raises(ValueError, match=r"T_WG has shape .*; expected \(3, 4, 4\)"):
            replace(made, T_WG=wrong)


def turned(axis: str, angles: Any) -> Array:
    angles = np.atleast_1d(angles)
    T = np.tile(np.eye(4), (len(angles), 1, 1))
    T[:, :3, :3] = Rotation.from_euler(axis, angles[:, None]).as_matrix()
    return T


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.3, np.pi / 2, 3.0, np.pi])
def test_geodesic_of_a_rotation(angle: float) -> None:
    base = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
    T_WO, T_WG = turned("y", angle), np.eye(4)
    T_WO[:, :3, :3], T_WG[:3, :3] = base @ T_WO[:, :3, :3], base
    assert geodesic_rad(targeted(T_WO, T_WG)) == pytest.approx(angle, abs=1e-9)
    # The paper's formula gives the same angle in the range where it is accurate.
    if 0.1 < angle < 3.1:
        trace = np.trace(T_WO[0, :3, :3] @ T_WG[:3, :3].T)
        assert geodesic_rad(targeted(T_WO, T_WG)) == pytest.approx(np.arccos(0.5 * (trace - 1)))


def test_a_quarter_turn_is_half_pi_about_any_axis() -> None:
    for axis in "xyz":
        assert geodesic_rad(targeted(turned(axis, np.pi / 2), np.eye(4))) == pytest.approx(np.pi / 2)


def test_errors_count_from_the_window_and_mpe_is_the_last() -> None:
    T_WO, T_WG = turned("z", [9.0, 0.3, 0.2, 0.1]), np.eye(4)
    T_WO[:, :3, 3] = [[9, 9, 9], [0.3, 0.4, 0], [0.03, 0.04, 0], [0.006, 0.008, 0.0]]
    moving = targeted(T_WO, T_WG, window_start=1)
    assert position_errors_m(moving) == pytest.approx([0.5, 0.05, 0.01])
    assert geodesic_errors_rad(moving) == pytest.approx([0.3, 0.2, 0.1])
    assert mpe_m(moving) == pytest.approx(0.01) and geodesic_rad(moving) == pytest.approx(0.1)


def test_a_target_may_move() -> None:
    T_WO, T_WG = turned("z", [0.0, 0.5, 1.0]), turned("z", [0.1, 0.6, 1.3])
    T_WG[:, 0, 3] = [0.01, 0.02, 0.03]
    moving = targeted(T_WO, T_WG)
    assert position_errors_m(moving) == pytest.approx([0.01, 0.02, 0.03])
    assert geodesic_errors_rad(moving) == pytest.approx([0.1, 0.1, 0.3])


def test_errors_without_a_target_or_a_motion() -> None:
    with pytest.raises(DataError, match=r"test:004_sugar_box\[0\]: the episode has no target"):
        mpe_m(record(at([0.6])))
    assert mpe_m(targeted(turned("z", [0.0]), np.eye(4), window_start=5)) is None
    broken = targeted(turned("z", [0.0, 0.0]), np.eye(4))
    broken.T_WO[1] = np.nan
    assert mpe_m(broken) == 0.0 and geodesic_rad(broken) == 0.0


def test_the_pose_of_a_grasp() -> None:
    episode = record(at([0.6, 0.7, 0.8]), window_start=2)
    episode.gc[:, 6:] = np.arange(3)[:, None]
    T_WH, pose, T_WO = grasp_pose(episode)  # type: ignore[misc]
    assert T_WO[2, 3] == 0.7 and (pose == 1.0).all() and (episode.T_WH[1] == T_WH).all()
    from_label = record(at([0.6]), window_start=0)
    T_WH, pose, T_WO = grasp_pose(from_label)  # type: ignore[misc]
    assert T_WO is from_label.label.T_WO and pose is from_label.label.hand_pose
    assert grasp_pose(record(at([0.6]), window_start=2, terminated="unstable")) is None


def test_distance_of_a_grasp_to_the_labels() -> None:
    """Moving hand and object together gives distance 0; moving only the object by 30 mm gives 30 mm."""
    made = record(at([0.6, 0.6, 0.6]), window_start=2)
    points = np.random.default_rng(4).normal(size=(21, 3))
    wanted = replace(made.label, joints_W=points)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.0, 0.0, 0.7]).as_matrix(), (1.0, 2.0, 3.0)
    gc = made.gc.copy()
    gc[1, 6 + 15] = np.radians(9.0)
    moved = replace(made, label=wanted, gc=gc, T_WO=np.tile(T, (3, 1, 1)),
                    joints_W=np.tile(points @ T[:3, :3].T + T[:3, 3], (3, 1, 1)))
    assert label_distance_mm(moved) == pytest.approx(0.0, abs=1e-9)
    assert label_angles_deg(moved) == pytest.approx(9.0 / 45)
    pushed = moved.T_WO.copy()
    pushed[1, :3, 3] += 0.03 * np.array([0.6, 0.0, 0.8])
    assert label_distance_mm(replace(moved, T_WO=pushed)) == pytest.approx(30.0)
    for other in (replace(moved, window_start=0), replace(moved, window_start=7)):
        assert label_distance_mm(other) is None and label_angles_deg(other) is None


def test_contact_ratio_over_the_whole_sequence() -> None:
    # Goals are parts 0 and 3. Over 4 steps part 0 touches once and part 3 three times: 4 of 8. Part 7 is not a goal.
    contacts = np.zeros((4, 16))
    contacts[0, 0] = 1.0
    contacts[1:, 3] = 1.0
    contacts[:, 7] = 1.0
    assert contact_ratio(record(at([0.6] * 4), window_start=3, contacts=contacts)) == pytest.approx(0.5)
    assert contact_ratio(record(at([0.6] * 4), of=label(goal=()))) is None
