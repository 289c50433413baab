from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from dgrasp.errors import DataError
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels import load
from dgrasp.labels.formats.native import write_native
from dgrasp.labels.load import FileContent, LabelFormat, LabelSet, load_labels, select
from dgrasp.labels.sources import SOURCES, LabelFiles
from tests.labels.files import dexycb_content, dump, make_labels, static_content


def test_reader_is_chosen_by_content_not_by_name(tmp_path: Path) -> None:
    write_native(tmp_path / "a.pkl", make_labels(), "p", "CC0-1.0", MANO_NAMES)
    labels = load_labels(tmp_path / "a.pkl")
    assert (labels.hand, labels.licence, labels.released_as) == ("free", "CC0-1.0", None)
    assert not labels.comparable_with_paper
    assert labels.sha256 == hashlib.sha256((tmp_path / "a.pkl").read_bytes()).hexdigest()
    released = load_labels(dump(tmp_path / "b.npz", dexycb_content()))
    assert released.hand == "mano_mean"
    assert not released.comparable_with_paper


@pytest.mark.parametrize(
    ("name", "key"),
    [("dexycb_test_labels.pkl", ("dexycb", "test")), ("contact_opt_train.pkl", ("contactopt", "train"))],
)
def test_files_of_the_release_are_known_by_name(tmp_path: Path, name: str, key: tuple[str, str]) -> None:
    content = static_content() if key[0] == "contactopt" else dexycb_content()
    labels = load_labels(dump(tmp_path / name, content))
    assert labels.released_as == key
    assert labels.comparable_with_paper
    assert "MANO" in labels.licence
    assert ("DexYCB" in labels.licence) == (key[0] == "dexycb")


@pytest.mark.parametrize("raw", [b"", b"P", b"hello", b"\x1f\x8c\x08", b"{}"])
def test_other_files_are_refused(tmp_path: Path, raw: bytes) -> None:
    (tmp_path / "a.pkl").write_bytes(raw)
    with pytest.raises(DataError, match=r"neither a joblib pickle nor a \.npz"):
        load_labels(tmp_path / "a.pkl")


def test_a_new_format_and_a_new_source_are_an_entry_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = LabelFiles("mine", "release", {"train": "mine_train.txt"}, "my terms", comparable_with_paper=False)
    monkeypatch.setitem(SOURCES, "mine", mine)
    read = LabelFormat(b"mine", "a text file", "a .txt of mine",
                       lambda path: FileContent(make_labels(), "free", MANO_NAMES, None))
    monkeypatch.setattr(load, "FORMATS", (*load.FORMATS, read))
    (tmp_path / "mine_train.txt").write_bytes(b"mine: 1")
    labels = load_labels(tmp_path / "mine_train.txt")
    assert (labels.hand, labels.licence, labels.released_as) == ("free", "my terms", ("mine", "train"))
    assert not labels.comparable_with_paper and len(labels.labels) == len(make_labels())
    (tmp_path / "a.pkl").write_bytes(b"other")
    with pytest.raises(DataError) as caught:
        load_labels(tmp_path / "a.pkl")
    assert str(caught.value).endswith(
        "a.pkl: neither a joblib pickle nor a .npz file nor a text file (it begins with b'othe'); expected a "
        ".pkl of the authors' release or a .npz written by `dgrasp labels` or a .txt of mine"
    )


def test_missing_file_and_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "no.pkl", tmp_path):
        with pytest.raises(DataError, match="no such label file"):
            load_labels(path)


@pytest.fixture
def labels(tmp_path: Path) -> LabelSet:
    return load_labels(dump(tmp_path / "a.pkl", dexycb_content(objects=(12, 3, 14), n=3)))


def test_select_keeps_the_order_of_the_file(labels: LabelSet) -> None:
    chosen = select(labels, ["025", "021_bleach_cleanser"], 2)
    assert [(x.object_id, x.index) for x in chosen.labels] == [
        ("021_bleach_cleanser", 0), ("021_bleach_cleanser", 1), ("025_mug", 0), ("025_mug", 1)
    ]
    assert chosen.objects == ["021_bleach_cleanser", "025_mug"]
    assert chosen.sha256 == labels.sha256


def test_select_without_a_choice_takes_all(labels: LabelSet) -> None:
    assert select(labels).labels == labels.labels
    assert len(select(labels, limit_per_object=1).labels) == 3
    assert len(select(labels, limit_per_object=99).labels) == 9
    assert len(labels.labels) == 9


def test_select_names_the_nearest(labels: LabelSet) -> None:
    with pytest.raises(DataError, match="did you mean '004_sugar_box'"):
        select(labels, ["004_suger_box"])
    there = "021_bleach_cleanser, 004_sugar_box, 025_mug"
    with pytest.raises(DataError, match=rf"no label of '011_banana', one of the 20 objects; it has {there}"):
        select(labels, ["011_banana"])


def test_select_says_that_an_added_object_has_no_labels(labels: LabelSet) -> None:
    with pytest.raises(DataError) as caught:
        select(labels, ["my_mug"], added={"my_mug": Path("my objects")})
    assert "no label of 'my_mug', an object that was added; it has 021_bleach_cleanser" in str(caught.value)
    command = "`dgrasp labels make --objects my_mug --number 25 --out my_mug.npz --store 'my objects'`"
    assert command in str(caught.value) and "did you mean" not in str(caught.value)
