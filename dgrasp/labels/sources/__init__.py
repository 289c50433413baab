"""The label sources, by the name that `labels.source` gives them.

To add one, write a module with a `LabelSource` and list it in `_ALL`. In data without the config's default source, the
default means the first source of that data that is listed.
"""

from __future__ import annotations

from dgrasp.labels.sources.free import FREE
from dgrasp.labels.sources.release import CONTACTOPT, DEXYCB, GRASPTTA
from dgrasp.labels.sources.source import DataKind, LabelFiles, LabelSource

_ALL: tuple[LabelSource, ...] = (DEXYCB, GRASPTTA, CONTACTOPT, FREE)
SOURCES: dict[str, LabelSource] = {source.name: source for source in _ALL}


def sources_in(data: DataKind) -> dict[str, LabelSource]:
    """The sources whose files lie in this kind of data folder, by name."""
    return {name: source for name, source in SOURCES.items() if source.data == data}


__all__ = ["SOURCES", "DataKind", "LabelFiles", "LabelSource", "sources_in"]
