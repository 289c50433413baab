"""`test --records` and `dgrasp export`, as users type them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dgrasp.cli import run_command
from dgrasp.eval.failures import report
from dgrasp.eval.summary import label_row
from dgrasp.export import film
from dgrasp.export.sequence import read_sequence, write_folder
from tests.commands.folder import make_folder
from tests.export.sequences import sequence


@pytest.fixture(scope="module")
def tested(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An evaluation of two labels with all of its output files."""
    place = tmp_path_factory.mktemp("tested")
    words = ["--baseline", "gt_pd", "--data", str(make_folder(place / "set")), "pool.kind=serial", "eval.window_s=0.3"]
    words += ["--json", str(place / "a.json"), "--report", str(place / "a.html"), "--records", str(place / "sequences")]
    assert run_command("test", words) == 0
    return place


def test_a_test_leaves_its_files(tested: Path) -> None:
    names = {path.name for path in tested.iterdir()}
    assert names == {"set", "a.json", "a.csv", "a.md", "a.tex", "a.html", "sequences"}
    result = json.loads((tested / "a.json").read_text())
    # 0.3 s are 10 control steps.
    assert len(result["held_over_time"]["t_s"]) == 11
    assert result["held_over_time"]["mean_over_labels"][-1] == result["mean_over_labels"]["success"]
    assert sum(result["failures"]["all"].values()) == 2
    assert (tested / "a.html").read_text().startswith("<!doctype html>")


def test_stored_sequences_give_the_metrics_again(tested: Path) -> None:
    result = json.loads((tested / "a.json").read_text())
    rows = []
    for name in ("004_sugar_box_0000", "005_tomato_soup_can_0000"):
        one = read_sequence(tested / "sequences" / f"{name}.npz")
        rows.append(label_row(one.record, one.about["window_s"]))
        assert one.about["data"] == result["data"] and one.about["mano"] is None
        assert all(len(mesh.faces) for mesh in (*one.meshes.hand, one.meshes.object))
    for again, row in zip(rows, result["per_label"], strict=True):
        for key, value in again.items():
            assert row[key] == (pytest.approx(value, rel=1e-3, abs=1e-3) if isinstance(value, float) else value), key
    assert report(rows, 0.3, one.record.dt)["failures"] == result["failures"]


def test_films_and_animations_can_show_the_collision_shapes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures = film.pictures
    monkeypatch.setattr(film, "pictures", lambda one, every: pictures(one, every, (64, 48)))
    write_folder(tmp_path / "in", [sequence()])
    file = str(tmp_path / "in" / "004_sugar_box_0000.npz")
    half = {}
    for name, words in (("surface", []), ("shapes", ["--shapes"])):
        for kind in ("glb", "gif"):
            assert run_command("export", [file, "--out", str(tmp_path / f"{name}.{kind}"), *words]) == 0
        data = (tmp_path / f"{name}.glb").read_bytes()
        file_json = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        (mesh,) = [mesh for mesh in file_json["meshes"] if mesh["name"] == "004_sugar_box"]
        half[name] = file_json["accessors"][mesh["primitives"][0]["attributes"]["POSITION"]]["max"]
    # The object reaches 2 cm to each side, its shape 4 cm.
    assert half == {"surface": pytest.approx([0.02, 0.05, 0.03]), "shapes": pytest.approx([0.04, 0.05, 0.03])}
    assert (tmp_path / "surface.gif").read_bytes() != (tmp_path / "shapes.gif").read_bytes()
    assert run_command("export", [file, "--out", str(tmp_path / "a.npz"), "--shapes"]) == 2
    assert "npz has no meshes to draw; leave out --shapes" in capsys.readouterr().err


def test_export_of_a_file_and_of_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folder(tmp_path / "in", [sequence(), sequence()])
    file = tmp_path / "in" / "004_sugar_box_0000.npz"
    assert run_command("export", [str(file), "--out", str(tmp_path / "box.glb")]) == 0
    assert (tmp_path / "box.glb").read_bytes()[:4] == b"glTF"
    assert run_command("export", [str(tmp_path / "in"), "--format", "npz", "--out", str(tmp_path / "out")]) == 0
    written = sorted((tmp_path / "out").iterdir())
    assert [path.name for path in written] == ["004_sugar_box_0000.npz", "004_sugar_box_0000_1.npz"]
    with np.load(written[0]) as arrays:
        assert arrays["joint_angles"].shape == (8, 45)
    assert "the hand 'free' was not made from a MANO file" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "a.xyz"], "no format in its name; expected --format npz|glb|gif|mp4"),
        (["--out", "here.glb"], "exists already"),
        (["--out", "a.glb", "--mano", "M.pkl"], "leave out --mano"),
    ],
)
def test_wrong_use_is_told(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_folder(Path("in"), [sequence()])
    Path("here.glb").write_bytes(b"mine")
    assert run_command("export", ["in/004_sugar_box_0000.npz", *words]) == 2
    assert said in capsys.readouterr().err
    assert Path("here.glb").read_bytes() == b"mine"


def test_a_folder_for_records_that_holds_something_is_refused_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.txt").write_text("x")
    assert run_command("test", ["--baseline", "gt_pd", "--data", "free", "--records", str(tmp_path)]) == 2
    assert "not an empty folder" in capsys.readouterr().err


def test_view_writes_a_page_and_opens_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_folder(tmp_path / "in", [sequence()])
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: bool(opened.append(address)))
    assert run_command("view", [str(tmp_path / "in")]) == 0
    page = (tmp_path / "in" / "view.html").read_text()
    assert opened == [(tmp_path / "in" / "view.html").as_uri()] and "no browser found" in capsys.readouterr().out
    text = page.split('id="replay-data">')[1].split("</script>")[0]
    (replay,) = json.loads(text)["replays"]
    assert (replay["object"], replay["index"], replay["n"]) == ("004_sugar_box", 0, 8)
    assert "The objects have true inertia." in page
    assert "Sequences 1" in page and "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")
    file, out = tmp_path / "in" / "004_sugar_box_0000.npz", tmp_path / "one.html"
    assert run_command("view", [str(file), "--out", str(out), "--no-browser"]) == 0
    assert ' id="shapes"\nautocomplete="off">' in out.read_text() and len(opened) == 1
    assert run_command("view", [str(file), "--out", str(out), "--no-browser", "--shapes"]) == 0
    assert ' id="shapes"\nautocomplete="off" checked>' in out.read_text()
    assert run_command("view", [str(file), "--out", str(tmp_path / "no" / "a.html")]) == 2
    assert run_command("view", [str(tmp_path / "none")]) == 2
    assert "error: " in capsys.readouterr().err
