"""Texts in stored sequences from other people cannot inject markup into a page."""

from __future__ import annotations

from pathlib import Path

from dgrasp.cli import run_command
from dgrasp.export.sequence import write_sequence
from dgrasp.report.page import replays_section
from tests.export.sequences import episode, sequence


def test_a_row_cannot_become_markup() -> None:
    bad = '<script>alert(1)</script>"'
    row = {"object": bad, "index": bad, "failure": bad, "lost_s": 0.5}
    section = replays_section([("sequences", episode(), row)])
    assert "<script>alert" not in section and "&lt;script&gt;" in section


def test_a_page_never_replaces_what_it_shows(tmp_path: Path) -> None:
    file = tmp_path / "a.npz"
    write_sequence(file, sequence())
    before = file.read_bytes()
    for out in (file, tmp_path, tmp_path / "page.txt"):
        assert run_command("view", [str(file), "--out", str(out), "--no-browser"]) == 2
    assert file.read_bytes() == before
    assert run_command("view", [str(file), "--out", str(tmp_path / "page.html"), "--no-browser"]) == 0
