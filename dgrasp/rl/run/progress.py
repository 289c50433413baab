"""Progress display of a training: a live bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

LINE_INTERVAL_S = 30.0
RECENT = 10
"""Epochs over which the share of held episodes runs."""


def format_duration(seconds: float) -> str:
    """Hours, minutes and seconds, such as 1:02:03."""
    minutes, second = divmod(int(seconds), 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour}:{minute:02d}:{second:02d}"


class TrainingProgress:
    """Shows epoch, control steps per second, time left, last return, share of held episodes and last success rate.

    total_steps: control steps of the whole training. done_steps: those made before the run was resumed.
    max_seconds: time limit of the training, s; it also bounds the time left.
    """

    def __init__(
        self,
        total_steps: int,
        done_steps: int,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
        max_seconds: float = float("inf"),
    ) -> None:
        self._max_seconds = max_seconds
        self._console = console if console is not None else Console(stderr=True)
        self._clock = clock
        self._total, self._first, self._done = total_steps, done_steps, done_steps
        self._start = self._last_line = clock()
        self._success: float | None = None
        self._return: float | None = None
        self._held: deque[float] = deque(maxlen=RECENT)
        self._paused = 0.0
        self._bar: Progress | None = None
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>5.1f}%"))
            self._bar = Progress(*columns, console=self._console, refresh_per_second=2)
            self._task = self._bar.add_task("", total=total_steps, completed=done_steps)
            self._bar.start()

    def advance(self, steps: int, place: str) -> None:
        """Add control steps. place: where the training is, such as "epoch 3/10"."""
        self._done += steps
        now = self._clock()
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, description=self._status(place, now))
        elif now - self._last_line >= LINE_INTERVAL_S:
            self._last_line = now
            self.message(self._status(place, now))

    def trained(self, returned: float, held: float | None) -> None:
        """Remember an epoch's return and, if episodes end with a hold, the share of them that were held."""
        self._return = returned
        if held is not None:
            self._held.append(held)

    @contextmanager
    def evaluation(self) -> Iterator[None]:
        """Context of an evaluation: its time is left out of the estimate of the time left."""
        begin = self._clock()
        try:
            yield
        finally:
            self._paused += self._clock() - begin

    def evaluating(self, place: str, done: int, total: int) -> None:
        """Show how far an evaluation is, in its own control steps."""
        text = f"{place}, evaluating: step {done} of {total}"
        if self._bar is not None:
            self._bar.update(self._task, description=text)
        elif self._clock() - self._last_line >= LINE_INTERVAL_S:
            self._last_line = self._clock()
            self.message(text)

    def success(self, success: float) -> None:
        """Set the last success rate to show, a fraction."""
        self._success = success

    def message(self, text: str) -> None:
        """Print a line of plain text, above the bar if there is one."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def close(self) -> None:
        """Stop the bar and restore the terminal."""
        if self._bar is not None:
            self._bar.stop()

    def _status(self, place: str, now: float) -> str:
        rate = (self._done - self._first) / max(now - self._start - self._paused, 1e-9)
        left = (self._total - self._done) / rate if rate > 0.0 else 0.0
        left = max(0.0, min(left, self._max_seconds - (now - self._start)))
        known = {"return": self._return, "held": sum(self._held) / len(self._held) if self._held else None,
                 "success": self._success}
        told = "".join(f", {name} {value:.3f}" for name, value in known.items() if value is not None)
        return f"{place}, {rate:,.0f} steps/s, {format_duration(left)} left{told}"
