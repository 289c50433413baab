"""Ctrl-C and SIGTERM: both interrupt, except where a save must come to its end."""

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
    """SIGTERM: whoever runs this wants the machine back, and counts a tidy end as success."""


class Interrupted(Exception):
    """The training was interrupted; `checkpoint` holds its last completed epoch. preempted: by SIGTERM."""

    def __init__(self, checkpoint: Path, epoch: int, preempted: bool = False) -> None:
        super().__init__(f"interrupted; epoch {epoch} is saved in {checkpoint}, continue with --resume")
        self.checkpoint, self.epoch, self.preempted = checkpoint, epoch, preempted


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise Preempted if number == signal.SIGTERM else KeyboardInterrupt


@contextlib.contextmanager
def _handling(handler: Any) -> Iterator[None]:
    # Only the main thread may set handlers; elsewhere the process keeps those that it has.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, old in before.items():
            # None: a handler that was not set from Python and cannot be put back.
            signal.signal(number, signal.SIG_DFL if old is None else old)


def interruptible() -> contextlib.AbstractContextManager[None]:
    """SIGINT raises KeyboardInterrupt, SIGTERM `Preempted`; in a background job too, which starts ignoring SIGINT."""
    return _handling(_interrupt)


def uninterruptible() -> contextlib.AbstractContextManager[None]:
    """Both signals are ignored."""
    return _handling(signal.SIG_IGN)
