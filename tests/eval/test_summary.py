from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dgrasp import __version__
from dgrasp.errors import DataError
from dgrasp.eval import summary
from dgrasp.eval.paper import paper_column
from dgrasp.eval.summary import Result, code_version, label_row, summarise
from tests.eval.records import DT, at, label, record, standing

FREE = {"hand": "free", "labels": "free_train.npz", "source": "free", "split": "train", "comparable_with_paper": False,
        "not_comparable": ["the hand is free, not the paper's"]}
PAPER = {"hand": "mano_mean", "labels": "x.pkl", "source": "dexycb", "split": "train", "comparable_with_paper": True}
COST = {"control_steps": 100, "wall_s": 2.0, "physics_share": 0.9}


def result(rows: Any, data: dict[str, Any] = FREE, method: str = "gt_pd") -> Result:
    return summarise(rows, method=method, engine="pybullet", window_s=5.0, seed=1, data=data, cost=COST)


def row(name: str, index: int, success: bool, **more: Any) -> dict[str, Any]:
    return {"object": name, "index": index, "success": success, **more}


def test_the_keys_are_those_of_the_interface_in_order() -> None:
    out = result([row("025_mug", 0, True)]).as_dict()
    assert list(out) == [
        "schema", "method", "engine", "window_s", "seed", "commit", "data", "n_labels", "mean_over_objects",
        "mean_over_labels", "per_object", "per_label", "paper", "correlation_with_paper", "cost", "intervals",
    ]
    assert (out["schema"], out["paper"], out["correlation_with_paper"]) == (1, None, None)
    assert (out["data"], out["cost"]) == (FREE, COST)
    assert json.loads(json.dumps(out, allow_nan=False)) == out


def test_means_over_objects_and_over_labels() -> None:
    rows = [row("025_mug", i, i == 0, sim_dist_mm_per_step=float(i)) for i in range(4)]
    rows.append(row("004_sugar_box", 0, True, sim_dist_mm_per_step=10.0))
    out = result(rows)
    assert out.per_object == {
        "025_mug": {"n": 4, "success": 0.25, "sim_dist_mm_per_step": 1.5},
        "004_sugar_box": {"n": 1, "success": 1.0, "sim_dist_mm_per_step": 10.0},
    }
    assert out.mean_over_objects == {"success": 0.625, "sim_dist_mm_per_step": 5.75}
    assert out.mean_over_labels == {"success": 0.4, "sim_dist_mm_per_step": 3.2}
    assert out.n_labels == 5


def test_rows_keep_the_order_of_the_file() -> None:
    rows = [row("025_mug", 0, True), row("004_sugar_box", 0, False), row("025_mug", 1, False)]
    assert [(r["object"], r["index"]) for r in result(rows).per_label] == [
        ("025_mug", 0), ("004_sugar_box", 0), ("025_mug", 1)
    ]


def test_what_was_not_computed_is_absent() -> None:
    rows = [
        row("025_mug", 0, False, sim_dist_mm_per_step=None, terminated="NaN in the state"),
        row("025_mug", 1, True, sim_dist_mm_per_step=4.0),
        row("004_sugar_box", 0, False),
    ]
    out = result(rows)
    assert out.per_label[0] == {"object": "025_mug", "index": 0, "success": False, "terminated": "NaN in the state"}
    assert out.per_object["025_mug"] == {"n": 2, "success": 0.5, "sim_dist_mm_per_step": 4.0}
    assert out.per_object["004_sugar_box"] == {"n": 1, "success": 0.0}
    assert out.mean_over_objects == {"success": 0.25, "sim_dist_mm_per_step": 4.0}


def test_numpy_values_become_plain_ones() -> None:
    out = result([row("025_mug", np.int64(0), np.bool_(True), contact_ratio=np.float32(0.5))])  # type: ignore[arg-type]
    assert out.per_label == [{"object": "025_mug", "index": 0, "success": True, "contact_ratio": 0.5}]
    assert type(out.per_label[0]["success"]) is bool
    json.dumps(out.as_dict())


def test_records_become_rows() -> None:
    held = record(at(np.full(12, 0.6)), window_start=2, contacts=np.ones((12, 16)), of=label("025_mug", 3))
    assert label_row(held, 10 * DT) == {
        "object": "025_mug", "index": 3, "success": True, "sim_dist_mm_per_step": 0.0, "sim_dist_mm_per_s": 0.0,
        "sim_dist_wrist_mm_per_step": 0.0, "contact_ratio": 1.0, "label_distance_mm": pytest.approx(600.0),
        "label_angles_deg": 0.0,
    }
    broken = record(at([0.6, np.nan]), window_start=2, terminated="NaN", of=label("025_mug", 4, goal=()))
    assert label_row(broken, 10 * DT) == {
        "object": "025_mug", "index": 4, "success": False, "failure": "broken", "lost_s": 0.0, "terminated": "NaN",
        "label_angles_deg": 0.0,
    }
    out = summarise([held, broken], method="gt_pd", engine="pybullet", window_s=10 * DT, seed=1, data=FREE, cost=COST)
    assert out.mean_over_labels["success"] == 0.5
    assert out.mean_over_labels["contact_ratio"] == 1.0
    assert "lost_s" not in out.mean_over_labels and "lost_s" not in out.intervals["mean_over_labels"]


def test_a_target_of_the_object_adds_its_errors() -> None:
    moving = record(at([0.6, 0.6, 0.6]), of=label("025_mug"))
    pose = np.eye(4)
    pose[2, 3] = 0.5
    moving = replace(moving, T_WG=standing(pose, 3))
    values = label_row(moving, 3 * DT)
    assert values["mpe_m"] == pytest.approx(0.1) and values["geodesic_rad"] == 0.0
    assert "mpe_m" not in label_row(record(at([0.6, 0.6, 0.6])), 3 * DT)


def test_intervals_and_what_interpenetration_was_measured_on() -> None:
    rows = [row("025_mug", i, i < 2, interpenetration_cm3=float(i)) for i in range(4)]
    about = {"hand_mesh": "part meshes", "measured": 4}
    out = summarise(rows, method="gt_pd", engine="pybullet", window_s=5.0, seed=1, data=FREE, cost=COST,
                    interpenetration=about)
    assert out.as_dict()["interpenetration"] == about
    low, high = out.intervals["mean_over_objects"]["interpenetration_cm3"]
    assert 0.0 <= low < 1.5 < high <= 3.0
    assert set(out.intervals["per_object"]["025_mug"]) == {"success", "interpenetration_cm3"}
    again = summarise(rows, method="gt_pd", engine="pybullet", window_s=5.0, seed=1, data=FREE, cost=COST)
    assert again.intervals == out.intervals and "interpenetration" not in again.as_dict()


def test_bad_rows() -> None:
    with pytest.raises(DataError, match="no evaluated labels"):
        result([])
    with pytest.raises(DataError, match=r"025_mug\[0\]: metric contact_ratio is nan"):
        result([row("025_mug", 0, True, contact_ratio=float("nan"))])


def _like_the_paper(method: str = "gt_pd") -> list[dict[str, Any]]:
    column = paper_column("dexycb", "train", method)
    assert column is not None
    return [
        row(name, 0, True, sim_dist_mm_per_step=20.0 - values["sim_dist_mm_per_step"])
        for name, values in column.items() if name != "average"
    ]


def test_beside_the_paper() -> None:
    out = result(_like_the_paper(), PAPER)
    assert out.paper is not None
    assert list(out.paper) == [
        "success", "sim_dist_mm_per_step", "interpenetration_cm3", "interpenetration_shell_cm3"
    ]
    assert out.paper["success"]["002_master_chef_can"] == 0.19
    # All 20 objects: the printed average, not the mean of the rounded rows (0.3145).
    assert out.paper["success"]["average"] == 0.31
    assert len(out.paper["success"]) == 21
    # Success does not vary here, so it has no correlation; the other metric was reversed.
    assert out.correlation_with_paper == {"sim_dist_mm_per_step": pytest.approx(-1.0)}


def test_a_part_of_the_objects_has_its_own_average() -> None:
    out = result([row("002_master_chef_can", 0, True), row("003_cracker_box", 0, False)], PAPER)
    assert out.paper is not None
    assert out.paper["success"] == {
        "002_master_chef_can": 0.19, "003_cracker_box": 0.16, "average": pytest.approx(0.175)
    }
    assert out.correlation_with_paper is None


def test_correlation_by_hand() -> None:
    # The paper: 0.19, 0.16, 0.32. Ours: 0, 0, 1. r = cov / (s s) with deviations (-1, -1, 2)/3 and
    # (-0.1, -0.19, 0.29)/3: 0.87 / sqrt(6 * 0.1302).
    rows = [row("002_master_chef_can", 0, False), row("003_cracker_box", 0, False), row("004_sugar_box", 0, True)]
    out = result(rows, PAPER)
    assert out.correlation_with_paper == {"success": pytest.approx(0.87 / np.sqrt(6 * 0.1302))}


@pytest.mark.parametrize(
    ("data", "method"),
    [(FREE, "gt_pd"), ({**PAPER, "comparable_with_paper": False}, "gt_pd"), (PAPER, "other"),
     ({**PAPER, "source": "grasptta"}, "gt_ik")],
)
def test_not_beside_the_paper(data: dict[str, Any], method: str) -> None:
    out = result(_like_the_paper(), data, method)
    assert out.paper is None
    assert out.correlation_with_paper is None


def test_objects_that_the_paper_lacks() -> None:
    contactopt = {**PAPER, "source": "contactopt"}
    assert result([row("024_bowl", 0, True)], contactopt).paper is None
    out = result([row("024_bowl", 0, True), row("025_mug", 0, True)], contactopt)
    assert out.paper is not None
    assert list(out.paper["success"]) == ["025_mug", "average"]


def test_the_version_of_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(summary, "shipped_root", lambda: tmp_path)
    assert code_version() == __version__
    (tmp_path / ".git").mkdir()

    def git(*args: Any, **kwargs: Any) -> Any:
        assert kwargs["cwd"] == tmp_path
        return subprocess.CompletedProcess(args, 0, stdout="abc123\n")

    monkeypatch.setattr(summary.subprocess, "run", git)
    assert code_version() == "abc123"
    monkeypatch.setattr(summary, "is_checkout", lambda: False)
    assert code_version() == __version__
    monkeypatch.setattr(summary, "is_checkout", lambda: True)
    monkeypatch.setattr(summary.subprocess, "run", lambda *a, **k: (_ for _ in ()).throw(FileNotFoundError()))
    assert code_version() == __version__
