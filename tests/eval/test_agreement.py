"""Agreement with RaiSim's outcomes: counts worked out by hand, per file and per object, and damaged files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgrasp.errors import DataError
from dgrasp.eval import agreement
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels.load import LabelSet
from tests.scenes import make_spec


@pytest.fixture
def whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LabelSet:
    """Six labels, of the objects 004, 004, 004, 025, 025, 025, in place of the train file."""
    one = make_spec(1).labels[0]
    labels = [replace(one, object_id=name, index=i) for name in ("004_sugar_box", "025_mug") for i in range(3)]
    made = LabelSet(labels, "hand", MANO_NAMES, "", tmp_path / "train.pkl", "", ("dexycb", "train"), True)
    monkeypatch.setattr(agreement, "load_labels", lambda path: made)
    return made


def _policy(folder: Path, places: object) -> Path:
    folder.mkdir()
    np.save(folder / agreement.FILE, np.asarray(places))
    return folder / "full.pt"


def test_places_count_in_the_file(whole: LabelSet, tmp_path: Path) -> None:
    # RaiSim held 0, 1 and 4; 0, 2 and 5 were held here: both held 0, neither held 3.
    policy = _policy(tmp_path / "all", [0, 1, 4])
    found = agreement.find_agreement(policy, whole, [True, False, True, False, False, True])
    assert found is not None
    assert (found.both, found.here_alone, found.there_alone, found.neither) == (1, 2, 2, 1)
    assert found.share == pytest.approx(2 / 6)
    assert found.labels_here_alone == ["004_sugar_box[2]", "025_mug[2]"]
    assert found.labels_there_alone == ["004_sugar_box[1]", "025_mug[1]"]
    assert "held only here: 004_sugar_box[2], 025_mug[2]" in found.lines()
    assert found.plain()["agreement"] == found.share


def test_a_choice_of_labels_keeps_their_places(whole: LabelSet, tmp_path: Path) -> None:
    mugs = replace(whole, labels=whole.labels[3:])
    found = agreement.find_agreement(_policy(tmp_path / "all", [0, 1, 4]), mugs, [False, True, False])
    assert found is not None and (found.both, found.neither, found.share) == (1, 2, 1.0)


def test_the_policy_of_one_object_counts_its_labels(whole: LabelSet, tmp_path: Path) -> None:
    policy = _policy(tmp_path / "025_mug_dexycb", [0, 2])
    found = agreement.find_agreement(policy, whole, [True] * 6)
    # The labels of the box are not labels of this policy.
    assert found is not None and (found.both, found.here_alone) == (2, 1) and found.labels_here_alone == ["025_mug[1]"]
    assert agreement.find_agreement(policy, replace(whole, labels=whole.labels[:3]), [True] * 3) is None


def test_nothing_is_known_of_other_labels_or_other_policies(whole: LabelSet, tmp_path: Path) -> None:
    policy = _policy(tmp_path / "all", [0])
    assert agreement.find_agreement(policy, replace(whole, released_as=("dexycb", "test")), [True] * 6) is None
    assert agreement.find_agreement(tmp_path / "full.pt", whole, [True] * 6) is None


@pytest.mark.parametrize("places", [[6], [-1], [0.5], [[1]], "text"])
def test_a_damaged_file_is_one_error(whole: LabelSet, tmp_path: Path, places: object) -> None:
    with pytest.raises(DataError, match="from 0 to 5"):
        agreement.find_agreement(_policy(tmp_path / "all", places), whole, [True] * 6)


def test_bytes_that_are_no_array_are_refused(whole: LabelSet, tmp_path: Path) -> None:
    policy = _policy(tmp_path / "all", [0])
    policy.with_name(agreement.FILE).write_bytes(b"garbage")
    with pytest.raises(DataError, match="not an array"):
        agreement.find_agreement(policy, whole, [True] * 6)
