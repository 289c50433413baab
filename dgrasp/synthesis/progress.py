"""How far `dgrasp labels make` is: the share that each process reports of its object, and the display of all."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from dgrasp.rl.run.interrupts import check_interrupted
from dgrasp.rl.run.progress import LINE_INTERVAL_S, format_duration

Report = Callable[[float], None]
"""Called with the share of an object's synthesis that is done, 0 to 1."""
TRIAL = {"mujoco": 0.4, "pybullet": 0.8}
"""Engine -> share of the time that the trial of the grasps takes, measured on the sugar box and the mug."""
_FIGURES = 0.02
"""Share of the time that the labels' figures take. The search takes what is left."""
_USUAL = 0.4
"""Share of a round's hands that are sound, as a rule."""
_POLL_S = 0.5
_SHOWN = 3
"""Objects under way that the display names."""
_T = TypeVar("_T")


def search_and_trial(engine: str) -> tuple[float, float]:
    """Shares of the time that the search for grasps and their trial in physics take."""
    trial = TRIAL.get(engine, 0.5)
    return 1.0 - trial - _FIGURES, trial


class SearchShare:
    """Reports how far the search of one object is. Its rounds are estimated from the grasps found so far.

    whole: what is reported at its end. wanted: grasps to find. batch: hands per round. most: rounds that the search
    takes at most, as a rule. steps: calls of `step` per round.
    """

    def __init__(self, report: Report, whole: float, wanted: int, batch: int, most: int, steps: int) -> None:
        self._report, self._whole, self._wanted, self._most, self._steps = report, whole, wanted, most, steps
        self._rounds, self._in_round, self._told = 0, 0, 0.0
        self._expected = min(math.ceil(wanted / (_USUAL * batch)), most)

    def step(self) -> None:
        """Report one more step of the present round."""
        self._in_round += 1
        self._tell()

    def round_done(self, found: int) -> None:
        """End a round. found: the grasps of all rounds so far."""
        self._rounds, self._in_round = self._rounds + 1, 0
        needed = math.ceil(self._wanted * self._rounds / found) if found else self._most
        self._expected = max(min(needed, self._most), self._rounds)
        self._tell()

    def _tell(self) -> None:
        done = self._rounds + min(self._in_round / self._steps, 1.0)
        # The estimate of the rounds may grow; the share does not shrink.
        self._told = max(self._told, min(done / max(self._expected, done), 1.0))
        self._report(self._whole * self._told)


class MakingProgress:
    """Shows how far all objects are, and the time left: a bar on a terminal's stderr, else a line now and then.

    names: the objects. shares: the share of each that is done, which other processes change.
    """

    def __init__(
        self, names: Sequence[str], shares: Iterable[float], console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._names, self._shares, self._clock = names, shares, clock
        self._console = console or Console(stderr=True)
        self._start = self._last_line = clock()
        self._bar: Progress | None = None
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._bar = Progress(TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"),
                                 console=self._console, refresh_per_second=2)  # fmt: skip
            self._task = self._bar.add_task("making labels", total=1.0)
            self._bar.start()

    def result(self, future: Future[_T]) -> _T:
        """The result of a process, with the progress shown until it is there."""
        while not wait([future], timeout=_POLL_S).done:
            self.show()
        self.show()
        return future.result()

    def show(self) -> None:
        """Bring the display up to date."""
        check_interrupted()
        now = self._clock()
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done(), description=self.status(now))
        elif now - self._last_line >= LINE_INTERVAL_S:
            self._last_line = now
            self._console.print(f"{self.status(now)} ({self._done():.0%})", markup=False, highlight=False,
                                soft_wrap=True)  # fmt: skip

    def status(self, now: float) -> str:
        """The objects that are done and under way, and the time left if anything is known of it."""
        shares, done = list(self._shares), self._done()
        busy = [f"{name} {share:.0%}" for name, share in zip(self._names, shares, strict=True) if 0.0 < share < 1.0]
        text = f"making labels: {sum(share >= 1.0 for share in shares)} of {len(shares)} objects"
        if busy:
            text += f", {', '.join(busy[:_SHOWN])}{', ...' if len(busy) > _SHOWN else ''}"
        if 0.0 < done < 1.0:
            text += f", about {format_duration((now - self._start) * (1.0 - done) / done)} left"
        return text

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.stop()

    def _done(self) -> float:
        return math.fsum(self._shares) / max(len(self._names), 1)


@contextmanager
def shown_progress(name: str) -> Iterator[Report]:
    """Show how far one object is, while this process makes its labels; yields what is to be called with the share."""
    shares = [0.0]
    shown = MakingProgress([name], shares)

    def report(share: float) -> None:
        shares[0] = share
        shown.show()

    try:
        yield report
    finally:
        shown.close()
