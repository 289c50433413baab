"""Outputs are checked before any work, and what is there stays."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dgrasp.errors import DataError
from dgrasp.files.atomic import write_atomic
from dgrasp.files.outputs import check_outputs


def test_outputs_that_cannot_be_are_refused(tmp_path: Path) -> None:
    label = tmp_path / "labels.npz"
    label.write_bytes(b"labels")
    new, again = tmp_path / "a.json", tmp_path / "b" / ".." / "a.json"
    (tmp_path / "b").mkdir()
    (tmp_path / "link.html").symlink_to(label)
    check_outputs({"--json": new, "--report": tmp_path / "r.html"}, [label, None])
    for outputs, said in (
        ({"--json": new, "--gif": again}, "--gif .* would overwrite what --json writes"),
        ({"--report": label}, r"labels\.npz, which is read"),
        ({"--report": tmp_path / "link.html"}, r"labels\.npz, which is read"),
        ({"--json": tmp_path / "b"}, "is no file"),
        ({"--json": tmp_path / "none" / "a.json"}, "does not exist"),
        ({"--json": Path(os.devnull)}, "is no file"),
        ({"--json": Path("")}, "is no file"),
    ):
        with pytest.raises(DataError, match=said):
            check_outputs(outputs, [label])


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "real.txt")
    write_atomic(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink() and (tmp_path / "real.txt").read_text() == "new"
