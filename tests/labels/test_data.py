"""Which data an experiment takes: the stated order, and what is said when something is not there."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from dgrasp import data
from dgrasp.config.experiment import Config, make_config
from dgrasp.config.sections import INERTIA, which_inertia
from dgrasp.data import resolve
from dgrasp.errors import DataError
from dgrasp.eval.paper import paper_column
from dgrasp.files import paths
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels.formats.native import write_native
from dgrasp.labels.sources import SOURCES, DataKind, LabelSource
from dgrasp.objects.store import StoredObject
from tests.labels.files import dexycb_content, dump, make_labels, static_content
from tests.reference import reference_or_skip


def release(folder: Path) -> Path:
    """A folder laid out like the authors' release, with made-up content."""
    for name in ("hand", "objects/004_sugar_box", "labels", "policies"):
        (folder / name).mkdir(parents=True)
    (folder / "hand" / "mano_mean.urdf").write_text("<robot name='hand'/>")
    dump(folder / "labels" / "dexycb_train_labels.pkl", dexycb_content(objects=(12, 3), n=3))
    dump(folder / "labels" / "dexycb_grasptta_train.pkl", static_content(objects=(3,), n=2))
    return folder


def recordings(folder: Path) -> Path:
    """A folder laid out like DexYCB itself."""
    (folder / "subject-01" / "sequence-1").mkdir(parents=True)
    (folder / "subject-01" / "sequence-1" / "meta.yml").write_text("")
    return folder


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project of its own, with just the free set in its data/."""
    monkeypatch.delenv("DGRASP_DATA", raising=False)
    monkeypatch.delenv("DEX_YCB_DIR", raising=False)
    folder = tmp_path / "project" / "data"
    (folder / "free" / "hand").mkdir(parents=True)
    (folder / "free" / "hand" / "free_hand.urdf").write_text("<robot name='free'/>")
    write_native(folder / "free" / "labels" / "free_train.npz", make_labels(), {"made": "here"}, "CC0-1.0", MANO_NAMES)
    monkeypatch.setattr(data, "data_root", lambda: folder)
    monkeypatch.setattr(data, "user_data_root", lambda: folder)
    return folder


def config(**values: Any) -> Config:
    return make_config(values)


def test_the_free_set_is_the_last_resort(home: Path) -> None:
    choice = resolve(config())
    assert (choice.kind, choice.hand, choice.source, choice.split) == ("free", "free", "free", "train")
    assert choice.hand_urdf == home / "free" / "hand" / "free_hand.urdf"
    assert choice.objects_dir == home / "free" / "objects"
    assert choice.licence == "CC0-1.0"
    assert not choice.comparable_with_paper
    line = choice.describe()
    assert "\n" not in line
    for part in ("data free", "hand free", "free train labels (free_train.npz)", "4 of 2 objects", "licence: CC0-1.0"):
        assert part in line


def test_the_order(home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def found() -> Path:
        return resolve(config()).root

    any_folder = release(home / "zzz")
    assert found() == any_folder
    first = release(home / "dexycb")
    assert found() == first
    monkeypatch.setenv("DEX_YCB_DIR", str(release(tmp_path / "dex")))
    assert found() == tmp_path / "dex"
    monkeypatch.setenv("DGRASP_DATA", str(release(tmp_path / "named")))
    assert found() == tmp_path / "named"
    assert "from DGRASP_DATA" in resolve(config()).describe()
    assert resolve(config(data=str(first))).root == first
    assert resolve(config(data="free")).kind == "free"
    monkeypatch.setenv("DGRASP_DATA", "free")
    assert found() == home / "free"


def test_raw_recordings_are_mentioned_and_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DEX_YCB_DIR", str(recordings(tmp_path / "dex")))
    choice = resolve(config())
    assert choice.kind == "free"
    said = f"{tmp_path / 'dex'} (DEX_YCB_DIR) holds DexYCB's raw recordings, which are not read directly"
    assert said in choice.describe()


def test_an_absent_dexycb_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Other programs use this variable too, so it is no order to this one.
    monkeypatch.setenv("DEX_YCB_DIR", str(tmp_path / "gone"))
    assert resolve(config()).kind == "free"


def test_stamp(tmp_path: Path) -> None:
    choice = resolve(config(data=str(release(tmp_path / "r"))))
    stamp = json.loads(json.dumps(choice.stamp()))
    assert stamp["hand_sha256"] == choice.hand_sha256
    assert len(stamp.pop("hand_sha256")) == len(stamp.pop("labels_sha256")) == 64
    assert "MANO" in stamp.pop("licence")
    assert stamp == {
        "kind": "release", "hand": "mano_mean", "labels": "dexycb_train_labels.pkl", "source": "dexycb",
        "split": "train", "n_labels": 6, "n_objects": 2, "hand_file": "mano_mean.urdf", "comparable_with_paper": True,
        "inertia": "official",
    }
    assert str(tmp_path) not in json.dumps(choice.stamp())


def test_inertia_follows_the_data(tmp_path: Path) -> None:
    root = str(release(tmp_path / "r"))
    for overrides, free, released in (({}, "true", "official"), ({"official_compat": True}, "official", "official"),
                                      ({"official_compat": False}, "true", "true")):  # fmt: skip
        for name, expected in (("free", free), (root, released)):
            choice = resolve(config(data=name, physics=overrides))
            assert choice.inertia == choice.stamp()["inertia"] == expected
            assert INERTIA[choice.inertia] in choice.describe()
    physics = config().physics
    assert physics.authors_inertia(released=True) and not physics.authors_inertia(released=False)
    assert which_inertia([True, True]) == "official" and which_inertia([False]) == "true"
    assert which_inertia([True, False]) == "mixed"
    assert choice.inertia_of("my_vase") == choice.inertia == "true"
    mixed = replace(choice, inertia="mixed", added={"my_vase": StoredObject(tmp_path, "0")})
    assert (mixed.inertia_of("my_vase"), mixed.inertia_of("004_sugar_box")) == ("true", "official")


def test_choice_of_objects_and_limit(tmp_path: Path) -> None:
    labels = {"objects": ["004_sugar_box"], "limit_per_object": 2}
    stamp = resolve(config(data=str(release(tmp_path / "r")), labels=labels)).stamp()
    assert (stamp["n_labels"], stamp["n_objects"]) == (2, 1)


def test_sources_and_files(tmp_path: Path, home: Path) -> None:
    root = release(tmp_path / "r")
    choice = resolve(config(data=str(root), labels={"source": "grasptta"}))
    assert (choice.source, choice.split, len(choice.labels.labels)) == ("grasptta", "train", 2)
    # A file of the release by its path, and by its name alone.
    for source in (str(root / "labels" / "dexycb_grasptta_train.pkl"), "dexycb_grasptta_train.pkl"):
        choice = resolve(config(data=str(root), labels={"source": source, "split": "test"}))
        assert (choice.source, choice.split, choice.comparable_with_paper) == ("grasptta", "train", True)
    other = dump(tmp_path / "mine.pkl", dexycb_content())
    choice = resolve(config(data=str(root), labels={"source": str(other)}))
    assert (choice.source, choice.split, choice.comparable_with_paper) == ("file", "file", False)
    assert "a file's labels (mine.pkl)" in choice.describe()
    free = home / "free" / "labels" / "free_train.npz"
    assert resolve(config(data="free", labels={"source": str(free)})).source == "file"
    assert resolve(config(data="free", labels={"source": "free"})).stamp() == resolve(config(data="free")).stamp()


@dataclass(frozen=True)
class Made:
    """A label source as a contributor may write one: it only has to have what `LabelSource` asks for."""

    name: str = "made_up"
    data: DataKind = "release"
    licence: str = "my terms"
    comparable_with_paper: bool = False

    @property
    def files(self) -> Mapping[str, str]:
        return {split: f"made_up_{split}.pkl" for split in ("train", "test")}


def test_a_label_source_is_an_entry_in_the_registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = release(tmp_path / "r")
    dump(root / "labels" / "made_up_test.pkl", dexycb_content(objects=(14,), n=2))
    made: LabelSource = Made()
    monkeypatch.setitem(SOURCES, made.name, made)
    choice = resolve(config(data=str(root), labels={"source": "made_up", "split": "test"}))
    assert (choice.source, choice.split, choice.licence) == ("made_up", "test", "my terms")
    assert choice.labels.objects == ["025_mug"] and len(choice.labels.labels) == 2
    assert choice.differences == ("the labels (made_up_test.pkl) are not the paper's",)
    for source, message in (("made_up", "no train split of made_up labels here; expected .*, made_up test$"),
                            ("made_up2", "'made_up2' is neither .*, made_up nor .*; did you mean 'made_up'")):
        with pytest.raises(DataError, match=message):
            resolve(config(data=str(root), labels={"source": source}))
    monkeypatch.setitem(SOURCES, made.name, Made(comparable_with_paper=True))
    assert resolve(config(data=str(root), labels={"source": "made_up", "split": "test"})).comparable_with_paper
    assert paper_column("made_up", "test", "gt_pd") is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"data": "nowhere"}, "data: no folder 'nowhere'; expected \"free\" or a folder laid out"),
        ({"data": ""}, "data: no folder"),
        ({"data": "a\0b"}, "data: no folder"),
        ({"data": "{tmp}"}, "data: {tmp} has no labels/; it holds project/, r/, raw/"),
        ({"data": "{tmp}/raw"}, "it holds DexYCB's raw recordings, which are not read directly"),
        ({"data": "{tmp}/r", "labels": {"split": "test"}},
         "no test split of dexycb labels here; expected one of the splits that are there: dexycb train, grasptta"),
        ({"data": "{tmp}/r", "labels": {"source": "contactopt"}}, "no train split of contactopt labels here"),
        ({"data": "{tmp}/r", "labels": {"source": "dexicb"}}, "did you mean 'dexycb'"),
        ({"data": "{tmp}/r", "labels": {"source": "x/y.npz"}}, "'x/y.npz' is neither dexycb, grasptta, contactopt nor"),
        ({"data": "{tmp}/r", "labels": {"source": ""}}, "is neither"),
        ({"data": "{tmp}/r", "labels": {"objects": ["025_mug"]}}, "no label of '025_mug'"),
        ({"data": "free", "labels": {"source": "grasptta"}}, "free set has no labels of grasptta; expected free, or"),
        ({"data": "free", "labels": {"split": "test"}},
         "no test split of free labels here; expected one of the splits that are there: free train"),
        ({"data": "{tmp}/r", "labels": {"source": "free"}},
         "{tmp}/r has no labels of free; expected dexycb, grasptta, contactopt, or --data free"),
        ({"data": "free", "labels": {"source": "{tmp}/r/labels/dexycb_train_labels.pkl"}},
         "labels made for the hand 'mano_mean', but the hand of"),
        ({"data": "{tmp}/r", "labels": {"source": "{tmp}/project/data/free/labels/free_train.npz"}},
         "labels made for the hand 'free', but the hand of {tmp}/r is 'mano_mean'"),
        ({"data": "{tmp}/r", "hand": "free"}, "hand: neither the hand of {tmp}/r ('mano_mean') nor a file: 'free'"),
        ({"fallback": "error"}, "`fallback: error` forbids the free set; looked at config key data (not set)"),
    ],
)
def test_messages(tmp_path: Path, values: dict[str, Any], message: str) -> None:
    release(tmp_path / "r")
    recordings(tmp_path / "raw")
    filled = json.loads(json.dumps(values).replace("{tmp}", str(tmp_path)))
    with pytest.raises(DataError, match=re.escape(message.replace("{tmp}", str(tmp_path)))):
        resolve(config(**filled))


def test_an_added_object_without_labels(tmp_path: Path) -> None:
    folder = release(tmp_path / "r") / "objects" / "my_mug"
    folder.mkdir(parents=True)
    (folder / "object.json").write_text("{}")
    with pytest.raises(DataError, match="no label of 'my_mug', an object that was added"):
        resolve(config(data=str(tmp_path / "r"), labels={"objects": ["my_mug"]}))
    with pytest.raises(DataError, match="051_large_clamp is object 19 of DexYCB, which has no grasps"):
        resolve(config(data=str(tmp_path / "r"), labels={"objects": ["051_large_clamp"]}))


def test_where_it_looked(tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DEX_YCB_DIR", str(recordings(tmp_path / "raw")))
    with pytest.raises(DataError) as caught:
        resolve(config(fallback="error"))
    looked = (f"{tmp_path / 'raw'} (DEX_YCB_DIR: raw recordings", f"{home / 'dexycb'} (data: no such folder)")
    for part in ("DGRASP_DATA (not set)", *looked):
        assert part in str(caught.value)
    assert resolve(config(fallback="error", data="free")).kind == "free"


@pytest.mark.parametrize(
    ("name", "message"),
    [("objects", "no folder objects/"), ("hand", "no such hand"), ("labels", "has no labels/")],
)
def test_an_incomplete_release_is_not_taken(tmp_path: Path, name: str, message: str) -> None:
    root = release(tmp_path / "r")
    shutil.rmtree(root / name)
    with pytest.raises(DataError, match=message):
        resolve(config(data=str(root)))


def test_a_hand_of_ones_own(tmp_path: Path) -> None:
    root = release(tmp_path / "r")
    variant = root / "hand" / "mano_mean_meshcoll.urdf"
    variant.write_text("<robot name='variant'/>")
    choice = resolve(config(data=str(root), hand=str(variant)))
    assert (choice.hand, choice.hand_urdf, choice.comparable_with_paper) == ("mano_mean", variant, False)
    assert resolve(config(data=str(root), hand="mano_mean")).comparable_with_paper
    other = tmp_path / "claw.urdf"
    other.write_text("<robot name='claw'/>")
    with pytest.raises(DataError, match=r"labels made for the hand 'mano_mean', but the hand of .* is 'claw'"):
        resolve(config(data=str(root), hand=str(other)))
    write_native(tmp_path / "claw.npz", make_labels(hand="claw"), "p", "l", MANO_NAMES)
    choice = resolve(config(data=str(root), hand=str(other), labels={"source": str(tmp_path / "claw.npz")}))
    assert choice.hand == "claw"


def test_the_release_itself() -> None:
    choice = resolve(config(data=str(reference_or_skip())))
    assert (choice.stamp()["n_labels"], choice.stamp()["n_objects"]) == (376, 20)
    assert choice.comparable_with_paper


def test_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = Path(paths.__file__).parents[1]
    assert paths.is_checkout()
    assert paths.data_root() == package.parent / "data" == paths.user_data_root()
    assert paths.cfg_root() == package.parent / "cfg"
    bundled = tmp_path / "_bundled"
    (bundled / "cfg").mkdir(parents=True)
    (bundled / "cfg" / "a.yaml").write_text("")
    monkeypatch.setattr(paths, "_BUNDLED", bundled)
    monkeypatch.chdir(tmp_path)
    assert paths.data_root() == bundled / "data"
    assert paths.user_data_root() == tmp_path / "data"
    assert paths.package_file("cfg/a.yaml") == bundled / "cfg" / "a.yaml"
    with pytest.raises(DataError, match=r"no such file comes with the package; in its folder: a\.yaml"):
        paths.package_file("cfg/b.yaml")
