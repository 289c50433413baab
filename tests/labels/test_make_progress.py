"""How far `labels make` says it is: the share within an object, and the display of all objects."""

from __future__ import annotations

import io
from concurrent.futures import ThreadPoolExecutor

import pytest
from rich.console import Console

from dgrasp.synthesis.progress import MakingProgress, SearchShare, search_and_trial

SEARCH = 0.5


def test_the_share_of_the_search_counts_rounds_and_steps() -> None:
    """Ten wanted of 5 hands a round, 2 of which are sound as a rule: 5 rounds; 3 in the first make it 4."""
    told: list[float] = []
    share = SearchShare(told.append, SEARCH, wanted=10, batch=5, most=6, steps=4)
    share.step()
    assert told[-1] == pytest.approx(SEARCH * 0.25 / 5)
    for _ in range(3):
        share.step()
    share.round_done(3)
    assert told[-1] == pytest.approx(SEARCH / 4)
    share.step()
    assert told[-1] == pytest.approx(SEARCH * 1.25 / 4)
    # Found nothing more: 7 rounds would be needed, 6 are the most.
    share.round_done(3)
    assert told[-1] == pytest.approx(SEARCH / 3)
    share.round_done(4)
    assert told[-1] == pytest.approx(SEARCH / 2)
    for found in (8, 12):
        share.round_done(found)
    assert told[-1] == pytest.approx(SEARCH)
    assert told == sorted(told)


def test_a_search_that_takes_more_rounds_than_usual_stays_below_its_whole() -> None:
    told: list[float] = []
    share = SearchShare(told.append, SEARCH, wanted=10, batch=5, most=2, steps=1)
    for _ in range(5):
        share.step()
        share.round_done(0)
    assert max(told) <= SEARCH and told == sorted(told)


def test_the_shares_of_the_time_add_up() -> None:
    """On PyBullet the trial takes most of it."""
    assert search_and_trial("mujoco") == pytest.approx((0.58, 0.4))
    assert search_and_trial("pybullet") == pytest.approx((0.18, 0.8))


class Clock:
    """A clock that tests set."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def display(shares: list[float], terminal: bool = False) -> tuple[MakingProgress, Clock, io.StringIO]:
    clock, stream = Clock(), io.StringIO()
    console = Console(file=stream, force_terminal=terminal, width=120, _environ={"TERM": "xterm"})
    return MakingProgress(["bowl", "mug", "can", "box"], shares, console, clock), clock, stream


def test_the_time_left_follows_from_the_share_of_all_objects() -> None:
    """After 60 s, (1 + 0.5) / 4 are done, so 100 s are left."""
    shares = [1.0, 0.5, 0.0, 0.0]
    shown, _, _ = display(shares)
    assert shown.status(160.0) == "making labels: 1 of 4 objects, mug 50%, about 0:01:40 left"
    shares[:] = [0.0] * 4
    assert shown.status(160.0) == "making labels: 0 of 4 objects"
    shares[:] = [0.25] * 4
    assert shown.status(160.0) == "making labels: 0 of 4 objects, bowl 25%, mug 25%, can 25%, ..., about 0:03:00 left"
    shares[:] = [1.0] * 4
    assert shown.status(160.0) == "making labels: 4 of 4 objects"


def test_without_a_terminal_there_is_a_line_now_and_then() -> None:
    shown, clock, stream = display([0.5, 0.0, 0.0, 0.0])
    for clock.now in (110.0, 131.0, 140.0, 162.0):
        shown.show()
    shown.close()
    assert stream.getvalue().splitlines() == [
        "making labels: 0 of 4 objects, bowl 50%, about 0:03:37 left (12%)",
        "making labels: 0 of 4 objects, bowl 50%, about 0:07:14 left (12%)",
    ]


def test_on_a_terminal_there_is_a_bar_with_the_time_left() -> None:
    shown, clock, stream = display([0.5, 0.5, 0.5, 0.5], terminal=True)
    clock.now = 130.0
    with ThreadPoolExecutor(1) as pool:
        assert shown.result(pool.submit(lambda: 7)) == 7
    shown.show()
    shown.close()
    assert "about 0:00:30 left" in stream.getvalue() and "50%" in stream.getvalue()
