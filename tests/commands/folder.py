"""A small data folder in the free layout, made by the tests."""

from __future__ import annotations

import shutil
from pathlib import Path

from dgrasp.files.paths import data_root
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels.formats.native import write_native
from dgrasp.types import GraspLabel
from tests.scenes import free_hand, make_label


def labels(count: int = 2) -> list[GraspLabel]:
    """Labels of the sugar box and the soup can."""
    hand = free_hand()
    names = ["004_sugar_box", "005_tomato_soup_can"]
    return [make_label(hand, names[i % 2], i // 2) for i in range(count)]


def make_folder(root: Path, count: int = 2) -> Path:
    """hand/ and labels/ like data/free."""
    (root / "hand").mkdir(parents=True)
    (root / "labels").mkdir()
    shutil.copy(data_root() / "free" / "hand" / "free_hand.urdf", root / "hand")
    for split in ("train", "test"):
        write_native(root / "labels" / f"free_{split}.npz", labels(count), {"made by": "tests"}, "MIT", MANO_NAMES)
    return root
