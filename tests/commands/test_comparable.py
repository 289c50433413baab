"""What `test` says above its table, and leaves out, where the paper's numbers are not comparable."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from dgrasp.cli import run_command
from dgrasp.files.paths import data_root
from tests.commands.folder import make_folder
from tests.labels.files import dexycb_content, dump
from tests.reference import reference_or_skip

QUICK = ["pool.kind=serial", "eval.interpenetration=false"]


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder laid out like the authors' release: a made-up label of the sugar box, and the free hand."""
    root = tmp_path_factory.mktemp("data") / "release"
    for name in ("hand", "labels", "objects/004_sugar_box"):
        (root / name).mkdir(parents=True)
    shutil.copy(data_root() / "free" / "hand" / "free_hand.urdf", root / "hand" / "mano_mean.urdf")
    dump(root / "labels" / "dexycb_train_labels.pkl", dexycb_content(objects=(3,), n=1))
    return root


def evaluated(words: list[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[list[str], dict[str, Any]]:
    """The lines that a test prints after the line about its data, and its JSON; checks that all outputs agree."""
    file = folder / "o.json"
    assert run_command("test", [*words, *QUICK, "--json", str(file), "--report", str(folder / "o.html")]) == 0
    lines = " ".join(capsys.readouterr().out.split("\n", 1)[1].split())
    above, table = lines.split("object n success", 1)
    result = json.loads(file.read_text())
    apart = "not comparable with the paper: " in above
    assert result["data"]["comparable_with_paper"] is not apart
    assert (result["paper"] is None) is apart and (result["correlation_with_paper"] is None or not apart)
    assert ("paper" in table.split("mean over objects")[0]) is not apart and "not comparable" not in table
    markdown, latex, page = (file.with_suffix(suffix).read_text() for suffix in (".md", ".tex", ".html"))
    assert ("| paper |" in markdown) is ("& paper" in latex) is ("beside the paper" in page) is not apart
    for why in result["data"].get("not_comparable", []):
        assert why in above and why in markdown and why in latex and why.replace("'", "&#x27;") in page
    return result["data"].get("not_comparable", []), result


def test_the_papers_labels_and_hand_stand_beside_the_paper(
    release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, result = evaluated(["--baseline", "gt_pd", "--data", str(release), "--window", "3.87"], tmp_path, capsys)
    assert found == [] and result["paper"]["success"]["004_sugar_box"] == 0.32


def test_the_shipped_policy_on_another_hand_says_so(
    release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It runs, because both hands have the same joints."""
    found, _ = evaluated(["--run", "pretrained", "--data", str(release), "--window", "3.87"], tmp_path, capsys)
    assert found == ["the policy was trained for the hand free, not mano_mean"]


def test_another_window_inertia_and_masses(release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--baseline", "gt_pd", "--data", str(release), "--window", "0.1", "physics.masses=ycb",
             "physics.official_compat=false"]  # fmt: skip
    found, _ = evaluated(words, tmp_path, capsys)
    assert found == ["the objects have true inertia, not the authors' 1 kg m2", "the window is 0.1 s, not 5 or 3.87 s",
                     "physics.masses is ycb, not official"]  # fmt: skip


def test_own_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = make_folder(tmp_path / "set")
    found, _ = evaluated(["--baseline", "gt_pd", "--data", str(folder), "eval.window_s=0.1"], tmp_path, capsys)
    assert found == ["the hand is free, not the paper's", "the labels (free_train.npz) are not the paper's",
                     "the objects have true inertia, not the authors' 1 kg m2", "the window is 0.1 s, not 5 or 3.87 s"]


def test_the_shipped_policy_on_the_authors_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--run", "pretrained", "--data", str(reference_or_skip()), "--objects", "004_sugar_box",
             "labels.limit_per_object=2"]  # fmt: skip
    found, _ = evaluated(words, tmp_path, capsys)
    assert found[0] == "the policy was trained for the hand free, not mano_mean" and len(found) == 2
