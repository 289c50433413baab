from __future__ import annotations

import base64
import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from dgrasp.eval import output
from dgrasp.eval.latex import latex_text
from dgrasp.eval.summary import summarise
from dgrasp.report import charts
from dgrasp.report.page import html_text, shown_episodes, write_report
from tests.eval.records import DT
from tests.eval.test_summary import COST, FREE, PAPER
from tests.export.sequences import episode
from tests.report.episodes import MUG, SUGAR, drawn, evaluated, page, records


class Read(HTMLParser):
    """The page's tables as rows of texts, its elements, links and data."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: dict[str, list[list[str]]] = {}
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self._table = ""
        self._cell = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.append((tag, found))
        if tag == "table":
            self._table = found.get("id") or found.get("class") or ""
            self.tables[self._table] = []
        elif tag == "tr":
            self.tables[self._table].append([])
        self._cell = tag in ("td", "th") or (self._cell and tag == "i")
        if tag in ("td", "th"):
            self.tables[self._table][-1].append("")

    def handle_data(self, data: str) -> None:
        if self._cell:
            self.tables[self._table][-1][-1] += data

    def handle_endtag(self, tag: str) -> None:
        self._cell = self._cell and tag not in ("td", "th")


@pytest.fixture(scope="module")
def read() -> Read:
    return Read(page())


def test_the_table_is_the_terminals(read: Read) -> None:
    header, rows = output.table_cells(evaluated())
    assert read.tables["results"] == [header, *rows]


def test_failures_are_counted_with_their_meaning(read: Read) -> None:
    rows = {row[0]: row[1:] for row in read.tables["kinds"][1:]}
    assert rows["held"][:2] == ["2", "50%"] and rows["lift"][:2] == ["2", "50%"] and rows["broken"][:2] == ["0", "0%"]
    assert list(rows) == ["held", "approach", "lift", "slip", "drop", "broken"] and all(rows[kind][2] for kind in rows)


def test_nothing_is_loaded_from_elsewhere(read: Read) -> None:
    policy = next(attrs["content"] for tag, attrs in read.tags if attrs.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None and policy.startswith("default-src 'none'")
    for tag, attrs in read.tags:
        assert tag not in ("link", "img", "iframe", "object") and "src" not in attrs, (tag, attrs)
        assert (attrs.get("href") or "data:").startswith("data:")
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|https?://", page())


def test_every_id_is_there_once_and_the_script_finds_its_own(read: Read) -> None:
    ids = [attrs["id"] for _, attrs in read.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    wanted = re.findall(r'find\("([a-z-]+)"\)|mark\("([a-z-]+)"', page())
    assert {a or b for a, b in wanted} <= set(ids)


def test_replays_are_the_worst_and_the_best(read: Read) -> None:
    data = json.loads(page().split('id="replay-data">')[1].split("</script>")[0])
    assert [(r["group"], r["object"], r["index"]) for r in data["replays"]] == [
        ("worst", MUG, 1), ("worst", SUGAR, 1), ("best", SUGAR, 0), ("best", MUG, 0),
    ]  # fmt: skip
    assert [r["outcome"] for r in data["replays"]] == ["lift", "lift", "held", "held"]
    assert set(data["objects"]) == {SUGAR, MUG}
    thumbs = [attrs["data-replay"] for tag, attrs in read.tags if tag == "button" and "data-replay" in attrs]
    assert thumbs == ["0", "1", "2", "3"]


def test_csv_json_latex_can_be_saved_from_the_page(read: Read) -> None:
    links = {attrs["download"]: attrs["href"] for tag, attrs in read.tags if tag == "a"}
    content = {str(name): base64.b64decode(str(href).split(",")[1]).decode() for name, href in links.items()}
    assert content["gt_pd.csv"] == output.csv_text(evaluated()) and "failure,lost_s" in content["gt_pd.csv"]
    assert content["gt_pd.tex"] == latex_text(evaluated())
    assert json.loads(content["gt_pd.json"])["failures"]["all"]["lift"] == 2


def test_twenty_replays_of_a_policys_test_fit_into_six_megabytes() -> None:
    # 60 steps of grasping and 173 of the window: 17 bodies with 3 + 4 numbers of 2 bytes, 2 bytes of contacts, base64.
    (one,) = json.loads(page().split('id="replay-data">')[1].split("</script>")[0])["replays"][:1]
    per_frame = sum(len(one[key]) for key in "pqc") / one["n"]
    assert per_frame == pytest.approx((17 * 14 + 2) * 4 / 3, rel=0.02)
    assert 20 * 233 * per_frame < 2e6


def test_beside_the_paper_there_are_its_numbers() -> None:
    names = ("002_master_chef_can", MUG)
    result = evaluated(PAPER, names)
    text = html_text(result, records(names), drawn(names))
    assert 'class="paper"' in text and "beside the paper" in text and "not comparable" not in text
    # (0.19 + 0.35) / 2 in the paper for these two objects.
    assert "paper <b>0.27</b>" in text
    assert 'class="paper"' not in page().split("<main>")[1] and "ot comparable with the paper" in page()


def test_the_head_says_the_inertia() -> None:
    text = html_text(evaluated({**FREE, "inertia": "mixed"}), records(), drawn())
    told = "the authors&#x27; inertia of 1 kg m2, true inertia for added objects"
    assert f"<dt>Inertia</dt><dd>{told}</dd>" in text and "<dt>Inertia</dt>" not in page()


def test_names_from_label_files_cannot_become_markup() -> None:
    evil = '<img src=x onerror=alert(1)>"</script>'
    names = (evil, MUG)
    text = html_text(evaluated(names=names), records(names), drawn(names))
    assert "<img" not in text and text.count("</script>") == 3
    data = json.loads(text.split('id="replay-data">')[1].split("</script>")[0])
    assert evil in data["objects"]


def test_a_simulation_that_broke_at_once_has_no_replay(tmp_path: Path) -> None:
    result, all_records = evaluated(), records()
    none = episode(label=all_records[3].label)
    for name in ("gc", "T_WH", "joints_W", "T_WO", "contacts", "contact_impulse", "table_contact", "reward"):
        setattr(none, name, getattr(none, name)[:0])
    assert len(shown_episodes(result, [*all_records[:3], none])) == 3
    write_report(tmp_path / "a.html", result, [none] * 4, drawn())
    text = (tmp_path / "a.html").read_text()
    assert 'id="stage"' not in text and 'id="results"' in text


def test_a_report_of_motions_has_their_errors_and_no_window() -> None:
    moved = [episode(label=record.label, T_WG=record.T_WO) for record in records()]
    rows = [{"object": r.label.object_id, "index": r.label.index, "target": 0, "mpe_m": 0.01 * k, "geodesic_rad": 0.1,
             "carried": k < 3} for k, r in enumerate(moved)]
    result = summarise(rows, method="policy", engine="pybullet", window_s=5.0, seed=1, data=FREE, cost=COST)
    result = dataclasses.replace(result, motion={"targets": "easy", "steps": 8})
    text = html_text(result, moved, drawn())
    assert "Position error" in text and "lost on the way" in text and "The wrist then carries" in text
    assert "Success over time" not in text and 'id="kinds"' not in text
    data = json.loads(text.split('id="replay-data">')[1].split("</script>")[0])
    assert data["replays"][0]["outcome"] == "lost on the way" and data["replays"][0]["bodies"] == 18


def test_axes_have_round_ends() -> None:
    assert [charts._nice(v) for v in (0.0, 0.9, 1.0, 1.1, 2.2, 3.0, 36.4, 410.0)] == [1, 1, 1, 2, 2.5, 4, 40, 500]


def test_the_curve_ends_at_the_success(read: Read) -> None:
    assert "mean over objects: 0.50 at the end" in page() and f"{5 * DT:.5f}"[:3] == "0.1"
