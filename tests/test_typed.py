"""Command lines that are printed can be typed."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from dgrasp.files.typed import typed


def test_paths_are_quoted_and_the_script_is_named_where_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    line = typed("test", ["--run", Path("my runs/a'b"), "labels.objects=[004, 005]"])
    assert shlex.split(line) == ["dgrasp", "test", "--run", "my runs/a'b", "labels.objects=[004, 005]"]
    (tmp_path / "test.py").touch()
    assert typed("test", ["--run", "a"]) == "python test.py --run a"
    assert typed("train", ["--resume", "a"]) == "dgrasp train --resume a"
