"""Handling of Ctrl-C and SIGTERM: both interrupt, except while a save must complete."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Preempted(KeyboardInterrupt):
    """Raised on SIGTERM: a scheduler reclaims the machine and counts a clean exit as success."""


class Interrupted(Exception):
    """The training was interrupted; `checkpoint` holds its last completed epoch. preempted: by SIGTERM."""

    def __init__(self, checkpoint: Path, epoch: int, preempted: bool = False) -> None:
        super().__init__(f"interrupted; epoch {epoch} is saved in {checkpoint}, continue with --resume")
        self.checkpoint, self.epoch, self.preempted = checkpoint, epoch, preempted


_received: type[KeyboardInterrupt] | None = None
"""What `_interrupt` has raised since the last `interruptible` ended."""


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _received
    _received = Preempted if number == signal.SIGTERM else KeyboardInterrupt
    raise _received


def check_interrupted() -> None:
    """Raise an interruption again that a library has swallowed, as trimesh does while it imports SciPy."""
    if _received is not None:
        raise _received


@contextlib.contextmanager
def _handling(handler: Any) -> Iterator[None]:
    # Only the main thread may set handlers; in other threads the present handlers stay.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, old in before.items():
            # None means that the old handler was not set from Python and cannot be restored.
            signal.signal(number, signal.SIG_DFL if old is None else old)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Make SIGINT raise KeyboardInterrupt and SIGTERM raise `Preempted`.

    This also applies to a background job, which would otherwise ignore SIGINT from its start. Long work within calls
    `check_interrupted` now and then.
    """
    global _received
    check_interrupted()
    try:
        with _handling(_interrupt):
            yield
    finally:
        _received = None


def uninterruptible() -> contextlib.AbstractContextManager[None]:
    """Ignore both signals."""
    return _handling(signal.SIG_IGN)
