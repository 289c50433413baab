"""The interface of a label source: labels that `labels.source` names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

DataKind = Literal["release", "free"]
"""A data folder: laid out like the authors' release, or the free set."""


class LabelSource(Protocol):
    """All that the project asks of a label source.

    name: what `labels.source` calls it. data: the kind of data folder that holds its files. files: split ("train",
    "test") -> name of the file in the folder's labels/, in any of `dgrasp.labels.load.FORMATS`. licence: the terms of
    files that state none. comparable_with_paper: whether the paper's tables report on these labels. A file that states
    its own terms was made by this project and never counts as comparable.
    """

    @property
    def name(self) -> str: ...

    @property
    def data(self) -> DataKind: ...

    @property
    def files(self) -> Mapping[str, str]: ...

    @property
    def licence(self) -> str: ...

    @property
    def comparable_with_paper(self) -> bool: ...


@dataclass(frozen=True)
class LabelFiles:
    """A `LabelSource` of fixed file names."""

    name: str
    data: DataKind
    files: Mapping[str, str]
    licence: str
    comparable_with_paper: bool
