"""The label files of the release themselves, where they are at hand: counts, order, frames, table height."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.errors import DataError
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels.formats.native import read_native, write_native
from dgrasp.labels.formats.release import read_release
from dgrasp.labels.load import load_labels
from dgrasp.objects.names import YCB_NAMES
from dgrasp.types import GraspLabel
from tests.reference import reference_or_skip

HO3D_ORDER = [12, 2, 3, 5, 9, 10, 14, 15, 17]
FILES = {
    "dexycb_train_labels.pkl": (376, list(YCB_NAMES)),
    "dexycb_grasptta_train.pkl": (400, list(YCB_NAMES)),
    "dexycb_grasptta_train_corrected.pkl": (400, list(YCB_NAMES)),
    "contact_opt_train.pkl": (180, HO3D_ORDER),
}


def _read(name: str) -> list[GraspLabel]:
    return read_release(reference_or_skip() / "labels" / name)


@pytest.mark.parametrize("name", FILES)
def test_counts_and_order(name: str) -> None:
    labels = _read(name)
    n, ids = FILES[name]
    assert len(labels) == n
    assert list(dict.fromkeys(label.object_id for label in labels)) == [YCB_NAMES[i] for i in ids]
    assert {label.on_table for label in labels} == {name == "dexycb_train_labels.pkl"}
    assert {label.start is not None for label in labels} == {name == "dexycb_train_labels.pkl"}


@pytest.mark.parametrize("name", FILES)
def test_wrist_rotation_and_key_points_are_of_one_rigid_palm(name: str) -> None:
    labels = _read(name)
    local = np.stack([
        (label.joints_W[[1, 5, 9, 13, 17]] - label.T_WH[:3, 3]) @ label.T_WH[:3, :3] for label in labels
    ])
    # With another Euler convention the knuckles scatter by several cm.
    assert np.ptp(local, axis=0).max() < 1e-9
    wrist = np.stack([label.joints_W[0] - label.T_WH[:3, 3] for label in labels])
    assert np.abs(wrist).max() == 0.0


def test_static_labels_have_the_object_at_the_origin() -> None:
    for name in ("dexycb_grasptta_train.pkl", "contact_opt_train.pkl"):
        for label in _read(name):
            np.testing.assert_allclose(label.T_WO, np.eye(4), atol=1e-6)


def test_objects_start_on_a_table_at_half_a_metre() -> None:
    root = reference_or_skip()
    heights = []
    for label in _read("dexycb_train_labels.pkl"):
        if label.object_id in ("003_cracker_box", "005_tomato_soup_can", "061_foam_brick"):
            assert label.start is not None
            mesh = (root / "objects" / label.object_id / "textured_meshlab.obj").read_text(encoding="utf-8")
            points = np.array([line.split()[1:4] for line in mesh.splitlines() if line.startswith("v ")], dtype=float)
            heights.append((points @ label.start.T_WO[2, :3]).min() + label.start.T_WO[2, 3])
    assert len(heights) == 19 + 21 + 19
    assert abs(np.median(heights) - 0.5) < 0.002
    assert max(abs(np.array(heights) - 0.5)) < 0.012


def test_native_round_trip_of_the_release(tmp_path) -> None:  # type: ignore[no-untyped-def]
    labels = _read("dexycb_train_labels.pkl")
    write_native(tmp_path / "a.npz", labels, "test", "test", MANO_NAMES)
    for one, two in zip(labels, read_native(tmp_path / "a.npz"), strict=True):
        assert (one.name, one.hand, one.on_table) == (two.name, two.hand, two.on_table)
        np.testing.assert_array_equal(one.joints_W, two.joints_W)
        np.testing.assert_array_equal(one.T_WH, two.T_WH)


def test_what_is_comparable_with_the_paper() -> None:
    root = reference_or_skip() / "labels"
    assert load_labels(root / "contact_opt_train.pkl").released_as == ("contactopt", "train")
    assert load_labels(root / "dexycb_train_labels.pkl").comparable_with_paper
    assert not load_labels(root / "dexycb_grasptta_train_corrected.pkl").comparable_with_paper


def test_the_motion_file_is_refused() -> None:
    with pytest.raises(DataError, match="'target_pos'"):
        _read("motion_eval_dict_easy.pkl")
