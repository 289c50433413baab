"""The exception for recordings that give no label."""

from __future__ import annotations


class Skip(Exception):
    """A recording that gives no label. reason: the same text for all recordings of this kind. detail: of this one."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(reason)
        self.reason, self.detail = reason, detail
