from __future__ import annotations

import numpy as np
import pytest

from dgrasp.eval.paper import paper_column, paper_tables
from dgrasp.objects.names import YCB_NAMES

METHODS = {
    "dexycb": ("gt_pd", "gt_ik", "policy"), "grasptta": ("gt_pd", "policy"), "contactopt": ("gt_pd", "policy"),
}
COLUMNS = [(source, split, method) for source in METHODS for split in ("train", "test") for method in METHODS[source]]


def test_numbers_as_printed() -> None:
    column = paper_column("dexycb", "train", "gt_pd")
    assert column is not None
    assert column["002_master_chef_can"] == {
        "success": 0.19, "sim_dist_mm_per_step": 18.0, "interpenetration_cm3": 5.68, "interpenetration_shell_cm3": 5.68
    }
    assert column["average"]["success"] == 0.31 and column["average"]["sim_dist_mm_per_step"] == 13.4
    assert column["average"]["interpenetration_cm3"] == column["average"]["interpenetration_shell_cm3"] == 4.59
    ours = paper_column("dexycb", "test", "policy")
    assert ours is not None
    assert ours["average"]["success"] == 0.63


@pytest.mark.parametrize(("source", "split", "method"), COLUMNS)
def test_columns_are_complete_and_average_as_printed(source: str, split: str, method: str) -> None:
    column = paper_column(source, split, method)
    assert column is not None
    names = [name for name in column if name != "average"]
    assert set(names) <= set(YCB_NAMES.values())
    assert len(names) == (9 if source == "contactopt" else 20)
    for metric, digits in (("success", 2), ("sim_dist_mm_per_step", 1), ("interpenetration_cm3", 2)):
        mean = float(np.mean([column[name][metric] for name in names]))
        assert column["average"][metric] == pytest.approx(mean, abs=0.51 * 10.0**-digits)


@pytest.mark.parametrize(
    ("source", "split", "method"),
    [("grasptta", "train", "gt_ik"), ("contactopt", "train", "gt_ik"), ("dexycb", "train", "other"),
     ("dexycb", "file", "gt_pd"), ("free", "train", "policy"), ("motion", "ours", "policy"), ("file", "file", "gt_pd")],
)
def test_no_column(source: str, split: str, method: str) -> None:
    assert paper_column(source, split, method) is None


def test_the_other_tables_are_there() -> None:
    assert {"motion", "ablation", "policy_scope", "unseen_objects", "ho3d_objects"} < set(paper_tables())
    assert paper_tables()["motion"]["flat_rl"]["mpe"] == 0.55
