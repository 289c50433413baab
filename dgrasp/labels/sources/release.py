"""The labels of the authors' release."""

from __future__ import annotations

from dgrasp.files import licences
from dgrasp.labels.sources.source import LabelFiles

DEXYCB = LabelFiles(
    "dexycb", "release", {"train": "dexycb_train_labels.pkl", "test": "dexycb_test_labels.pkl"}, licences.DEXYCB,
    comparable_with_paper=True,
)  # fmt: skip
GRASPTTA = LabelFiles(
    "grasptta", "release", {"train": "dexycb_grasptta_train.pkl", "test": "dexycb_grasptta_test.pkl"}, licences.MANO,
    comparable_with_paper=True,
)  # fmt: skip
CONTACTOPT = LabelFiles(
    "contactopt", "release", {"train": "contact_opt_train.pkl", "test": "contact_opt_test.pkl"}, licences.MANO,
    comparable_with_paper=True,
)  # fmt: skip
