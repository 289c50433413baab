"""Classes of failure on records made by hand: a grasping phase of 10 steps, then a window of 40 steps (1.15 s)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dgrasp.eval import failures
from dgrasp.eval.failures import counts, held_over_time, outcome
from dgrasp.eval.metrics import success
from dgrasp.types import Array, EpisodeRecord
from raisim_like.rotations import matrix_from_euler
from tests.eval.records import DT, at, record

START, STEPS = 10, 40
WINDOW = STEPS * DT


def episode(last_touch: int | None, landed: int | None, first_touch: int = 5, **changes: Any) -> EpisodeRecord:
    """The hand touches the object from `first_touch` to `last_touch`; the object lands at `landed` (None: never)."""
    n = START + STEPS
    steps = np.arange(n)
    touch = (steps >= first_touch) & (steps <= (n if last_touch is None else last_touch))
    contacts = np.zeros((n, 16))
    contacts[:, 3] = touch
    table = np.zeros(n, bool) if landed is None else steps >= landed
    table[:START] = True
    if last_touch is not None and last_touch < first_touch:
        contacts[:] = 0.0
    return record(changes.pop("position", at(np.full(n, 0.6))), window_start=START, contacts=contacts, table=table,
                  **changes)


def moved(offset: tuple[float, float, float], since: int) -> Array:
    """Positions displaced by `offset` from step `since` on."""
    position = at(np.full(START + STEPS, 0.6))
    position[since:] += offset
    return position


def test_held_is_success() -> None:
    end = outcome(episode(None, None), WINDOW)
    assert (end.kind, end.step, end.lost_s) == ("held", None, None)
    assert success(episode(None, None), WINDOW)


def test_lift_is_a_loss_in_the_first_half_second() -> None:
    # The table is removed before step 10; the last touch is in step 12, whose state is 3 steps later.
    end = outcome(episode(12, 20), WINDOW)
    assert (end.kind, end.step) == ("lift", 12)
    assert end.lost_s == pytest.approx(3 * DT)
    # 0.5 s are 17.3 steps: a last touch 17 steps after the table was removed is "lift", one after 18 steps is not.
    assert outcome(episode(START + 16, 40), WINDOW).kind == "lift"
    assert outcome(episode(START + 17, 40), WINDOW).kind == "drop"


def test_never_touched_is_approach_from_time_zero() -> None:
    end = outcome(episode(-1, 17), WINDOW)
    assert (end.kind, end.step, end.lost_s) == ("approach", START - 1, 0.0)
    # A touch that ended 6 steps (0.17 s) before the table was removed does not count as a grip; 5 steps (0.144 s) does.
    assert outcome(episode(START - 6, 17, first_touch=2), WINDOW).kind == "approach"
    assert outcome(episode(START - 5, 17, first_touch=2), WINDOW).kind == "lift"


def test_pushed_or_tipped_before_the_table_goes_is_approach() -> None:
    assert outcome(episode(30, 40, position=moved((0.051, 0.0, 0.0), 8)), WINDOW).kind == "approach"
    assert outcome(episode(30, 40, position=moved((0.049, 0.0, 0.0), 8)), WINDOW).kind == "drop"
    # Upward motion does not count as a push.
    assert outcome(episode(30, 40, position=moved((0.0, 0.0, 0.2), 8)), WINDOW).kind == "drop"
    for angles, kind in (((0.6, 0.0, 0.0), "approach"), ((0.5, 0.0, 0.0), "drop"), ((0.0, 0.0, 2.0), "drop")):
        one = episode(30, 40)
        one.T_WO[8:, :3, :3] = matrix_from_euler(np.array(angles))
        assert outcome(one, WINDOW).kind == kind, angles


def test_an_object_that_was_pushed_and_is_held_was_held() -> None:
    assert outcome(episode(None, None, position=moved((0.2, 0.0, 0.0), 5)), WINDOW).kind == "held"


def test_slip_is_sliding_in_the_hand_before_the_loss() -> None:
    # The last touch is in step 35. 0.2 s before it are 7 steps, so step 28 decides.
    assert outcome(episode(35, 42, position=moved((0.0, 0.0, -0.021), 28)), WINDOW).kind == "slip"
    assert outcome(episode(35, 42, position=moved((0.0, 0.0, -0.021), 29)), WINDOW).kind == "drop"
    assert outcome(episode(35, 42, position=moved((0.0, 0.0, -0.019), 28)), WINDOW).kind == "drop"


def test_a_hand_that_carries_the_object_away_does_not_let_it_slip() -> None:
    one = episode(35, 42, position=moved((0.0, 0.1, 0.0), 20))
    T_WH = one.T_WH.copy()
    T_WH[20:, 1, 3] += 0.1
    one.T_WH = T_WH
    assert outcome(one, WINDOW).kind == "drop"
    # If the wrist turns, an object that stays in the world far from it moves in the wrist's frame.
    one.T_WH = T_WH.copy()
    one.T_WH[20:, :3, :3] = matrix_from_euler(np.array([0.2, 0.0, 0.0]))
    assert outcome(one, WINDOW).kind == "slip"


def test_an_episode_without_a_grasping_phase_is_judged_by_its_first_steps() -> None:
    n = 40
    contacts = np.zeros((n, 16))
    contacts[4:8] = 1.0
    table = np.arange(n) >= 12
    end = outcome(record(at(np.full(n, 0.6)), contacts=contacts, table=table), n * DT)
    assert end.kind == "lift" and end.step == 7
    contacts[4] = 0.0
    assert outcome(record(at(np.full(n, 0.6)), contacts=contacts, table=table), n * DT).kind == "approach"


def test_broken_unless_it_was_lost_before() -> None:
    broken = record(at(np.full(15, 0.6)), window_start=10, terminated="NaN", contacts=np.ones((15, 16)))
    end = outcome(broken, WINDOW)
    assert (end.kind, end.step) == ("broken", 14) and end.lost_s == pytest.approx(5 * DT)
    early = record(at(np.full(4, 0.6)), window_start=10, terminated="NaN")
    assert outcome(early, WINDOW).lost_s == 0.0
    fell = record(at(np.full(30, 0.6)), window_start=10, terminated="NaN", contacts=np.ones((30, 16)),
                  table=np.arange(30) >= 12)
    assert outcome(fell, WINDOW).kind == "lift"
    assert outcome(record(np.zeros((0, 3)), window_start=10, terminated="NaN"), WINDOW).lost_s == 0.0


def test_held_over_time_ends_at_the_success_rate() -> None:
    rows = [
        {"object": "a", "success": False, "failure": "approach", "lost_s": 0.0},
        {"object": "a", "success": False, "failure": "lift", "lost_s": 2 * DT},
        {"object": "a", "success": True},
        {"object": "a", "success": True},
        {"object": "b", "success": False, "failure": "drop", "lost_s": 4 * DT},
    ]
    times, shares = held_over_time(rows, 4 * DT, DT)
    assert times == pytest.approx(np.arange(5) * DT)
    assert shares["a"].tolist() == [0.75, 0.75, 0.5, 0.5, 0.5]
    assert shares["b"].tolist() == [1.0, 1.0, 1.0, 1.0, 0.0]
    found = failures.report(rows, 4 * DT, DT)
    assert found["held_over_time"]["mean_over_objects"] == [0.875, 0.875, 0.75, 0.75, 0.25]
    # (4 * 0.75 + 1) / 5 = 0.8; at the end (4 * 0.5 + 0) / 5.
    assert found["held_over_time"]["mean_over_labels"] == [0.8, 0.8, 0.6, 0.6, 0.4]
    assert found["failures"]["all"] == {"held": 2, "approach": 1, "lift": 1, "slip": 0, "drop": 1, "broken": 0}
    assert found["failures"]["per_object"]["b"] == counts(rows[4:])
    assert set(failures.MEANINGS) == set(failures.KINDS)
