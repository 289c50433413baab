"""The paper's sets of unseen objects."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from dgrasp.errors import DataError
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels.load import LabelSet, select
from dgrasp.labels.splits import UNSEEN, object_set
from dgrasp.objects.names import YCB_NAMES
from tests.labels.files import make_labels


def test_six_sets_of_three() -> None:
    assert list(UNSEEN) == [1, 2, 3, 4, 5, 6]
    for number, names in UNSEEN.items():
        assert len(set(names)) == 3 and set(names) <= set(YCB_NAMES.values())
        assert object_set(f"unseen_{number}") == set(names)
        seen = object_set(f"seen_{number}")
        assert seen is not None and len(seen) == 17 and not seen & set(names)
    # In the supplement's table the soup can and the clamp are left out twice, the others once or never.
    counts = Counter(name for names in UNSEEN.values() for name in names)
    assert {name[:3] for name, count in counts.items() if count == 2} == {"005", "052"} and max(counts.values()) == 2


def test_as_a_choice_of_objects() -> None:
    # Of the sugar box, which set 1 leaves out, and of the mug, which no set does.
    labels = LabelSet(make_labels(), "free", MANO_NAMES, "l", Path("a.npz"), "0", None, False)
    assert select(labels, ["seen_1"]).objects == ["025_mug"]
    assert select(labels, ["unseen_1"]).objects == ["004_sugar_box"]
    assert select(labels, ["unseen_1", "025"]).objects == ["004_sugar_box", "025_mug"]
    assert select(labels, ["seen_2"]).objects == ["004_sugar_box", "025_mug"]
    with pytest.raises(DataError, match=r"a\.npz: no label of an object of 'unseen_2'; it has 004_sugar_box"):
        select(labels, ["unseen_2"])
    for name in ("unseen_7", "seen_0", "unseen_" + "1" * 5000):
        with pytest.raises(DataError, match="expected seen_1 to seen_6 or unseen_1 to unseen_6"):
            select(labels, [name])
    with pytest.raises(DataError, match="unknown object 'unseen'"):
        select(labels, ["unseen"])
