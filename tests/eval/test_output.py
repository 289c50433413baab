from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from dgrasp.errors import DataError
from dgrasp.eval import output
from dgrasp.eval.summary import Result, summarise
from tests.eval.test_summary import COST, FREE, PAPER, result, row

ROWS = [
    row("002_master_chef_can", 0, True, sim_dist_mm_per_step=1.25, interpenetration_cm3=2.0),
    row("002_master_chef_can", 1, False, sim_dist_mm_per_step=24.0, interpenetration_cm3=3.0, terminated="NaN, twice"),
    row("025_mug", 0, True, sim_dist_mm_per_step=0.5),
]


@pytest.fixture
def free() -> Result:
    return result(ROWS, {**FREE, "licence": "CC0 [red]x"})


@pytest.fixture
def beside() -> Result:
    return result(ROWS, PAPER)


def shown(one: Result, width: int = 200) -> str:
    stream = io.StringIO()
    output.print_table(one, Console(file=stream, width=width))
    return stream.getvalue()


def test_cells(free: Result) -> None:
    header, rows = output.table_cells(free)
    assert header == ["object", "n", "success", "SimDist mm/step", "interpen. cm3"]
    assert rows == [
        ["002_master_chef_can", "2", "0.50", "12.6", "2.50"],
        ["025_mug", "1", "1.00", "0.5", ""],
        ["mean over objects", "2", "0.75", "6.6", "2.50"],
        ["mean over labels", "3", "0.67", "8.6", "2.50"],
    ]


def test_ours_beside_the_paper(beside: Result) -> None:
    header, rows = output.table_cells(beside)
    assert header == ["object", "n", "success", "paper", "SimDist mm/step", "paper", "interpen. cm3", "paper"]
    assert rows[0] == ["002_master_chef_can", "2", "0.50", "0.19", "12.6", "18.0", "2.50", "5.68"]
    # (0.19 + 0.35) / 2 in the paper for these two objects.
    assert rows[2][2:4] == ["0.75", "0.27"]
    # The paper averages only over objects.
    assert rows[3][2:4] == ["0.67", ""]


def test_printed(free: Result, beside: Result) -> None:
    text = shown(free)
    assert text.startswith("not comparable with the paper: the hand is free, not the paper's\n")
    assert "licence CC0 [red]x" in text
    assert "gt_pd, pybullet, window 5 s, 3 labels" in text
    assert "paper" in shown(beside)
    assert output.NOT_COMPARABLE not in shown(beside)
    assert shown(result(ROWS, PAPER, "other")).startswith(output.NO_COLUMN + "\n")
    assert output.notices(result(ROWS, {"hand": "free"})) == [
        "not comparable with the paper: hand or labels are not the paper's"
    ]


def test_correlation_is_told() -> None:
    rows = [row("002_master_chef_can", 0, False), row("003_cracker_box", 0, False), row("004_sugar_box", 0, True)]
    assert "correlation with the paper over objects: success 0.98" in shown(result(rows, PAPER))


def test_on_the_terminal_it_fits_80_columns_and_says_what_it_rests_on() -> None:
    rows = [row(f"00{i}_{'x' * 17}", k, k > 0, sim_dist_mm_per_step=24.0, contact_ratio=0.5, interpenetration_cm3=12.34,
                interpenetration_shell_cm3=11.0) for i in range(2, 5) for k in range(3)]
    rows += [row("002_master_chef_can", k, True, sim_dist_mm_per_step=20.0, contact_ratio=0.5, interpenetration_cm3=2.0,
                 interpenetration_shell_cm3=5.0) for k in range(2)]
    about = {"hand_mesh": "part meshes", "object_mesh": "detailed", "as_in_the_paper": False, "measured": 11,
             "doubtful": ["x"], "failed": [], "seconds_per_episode": 0.031, "holes_capped_in_objects": 2}
    one = summarise(rows, method="gt_pd", engine="pybullet", window_s=5.0, seed=1, data=PAPER, cost=COST,
                    interpenetration=about)
    text = shown(one, width=80)
    table = text.split("mean over labels")[0]
    assert "…" not in table and "interpen." in table and "success" in table and "contact" not in table
    for said in ("95% intervals of the means", "the hand's part meshes, objects' detailed meshes", "MANO's skin",
                 "doubtful on 1 labels", "2 holes capped", "0.03 s per label", "that way: 9.50 cm3, paper 5.68"):
        assert said in text.replace("\n", " "), said
    assert "interpen. by shell cm3" in output.markdown_text(one)
    plain = summarise(rows, method="gt_pd", engine="pybullet", window_s=5.0, seed=1, data=FREE, cost=COST)
    assert "contact" in shown(plain, width=80) and "MANO's skin" not in shown(plain)


def test_json(tmp_path: Path, beside: Result) -> None:
    path = tmp_path / "new" / "a.json"
    output.write_json(beside, path)
    assert json.loads(path.read_text()) == beside.as_dict()
    assert [p.name for p in path.parent.iterdir()] == ["a.json"]


def test_csv(tmp_path: Path, free: Result) -> None:
    output.write_csv(free, tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["object", "index", "success", "sim_dist_mm_per_step", "interpenetration_cm3", "terminated"]
    assert rows[1]["terminated"] == "NaN, twice"
    assert rows[2]["interpenetration_cm3"] == ""
    assert [r["success"] for r in rows] == ["True", "False", "True"]


def test_markdown(tmp_path: Path, free: Result) -> None:
    output.write_markdown(free, tmp_path / "a.md")
    lines = (tmp_path / "a.md").read_text().splitlines()
    assert lines[0] == "## gt_pd, pybullet, window 5 s, 3 labels"
    assert lines[2] == "**not comparable with the paper: the hand is free, not the paper's**"
    lines = lines[2:]
    assert lines[2] == "| object | n | success | SimDist mm/step | interpen. cm3 |"
    assert lines[3] == "| --- | ---: | ---: | ---: | ---: |"
    assert lines[4] == "| 002_master_chef_can | 2 | 0.50 | 12.6 | 2.50 |"
    assert not any(output.NOT_COMPARABLE in line for line in lines[1:])


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, free: Result) -> None:
    path = tmp_path / "a.json"
    path.write_text("old")
    with pytest.raises(DataError, match="cannot be written"):
        output.write_json(free, path / "b.json")
    assert path.read_text() == "old"


@pytest.mark.parametrize(
    ("inertia", "words"),
    [("true", "true inertia"), ("official", "the authors' inertia of 1 kg m2"), (None, None)],
)
def test_the_inertia_in_words(inertia: str | None, words: str | None) -> None:
    one = result(ROWS, FREE if inertia is None else {**FREE, "inertia": inertia})
    last = output.remarks(one)[-1]
    assert "inertia" not in last if words is None else f"; {words}; seed" in last
    assert words is None or f"; {words}; seed" in output.markdown_text(one)
