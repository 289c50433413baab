"""What gives no label, and why."""

from __future__ import annotations


class Skip(Exception):
    """A recording that gives no label: its reason, the same text for all of its kind, and a detail."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(reason)
        self.reason, self.detail = reason, detail
