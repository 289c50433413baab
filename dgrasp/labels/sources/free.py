"""The free set's own labels."""

from __future__ import annotations

from dgrasp.files import licences
from dgrasp.labels.sources.source import LabelFiles

FREE = LabelFiles(
    "free", "free", {"train": "free_train.npz", "test": "free_test.npz"}, licences.PROJECT, comparable_with_paper=False
)
