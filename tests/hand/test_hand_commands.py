"""The words of `dgrasp hand`: betas from files, reports of hands that were not built here."""

from __future__ import annotations

from pathlib import Path

import pytest

from dgrasp.cli import main
from dgrasp.commands.hand_build import read_betas
from dgrasp.errors import DataError
from tests.reference import reference_or_skip


def test_betas_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "mano.yml").write_text("betas: [0.5, -1, 2.5e-1]\n")
    assert read_betas([str(tmp_path / "mano.yml")]).tolist() == [0.5, -1.0, 0.25]
    (tmp_path / "list.yml").write_text("- 1\n- 2\n")
    assert read_betas([str(tmp_path / "list.yml")]).tolist() == [1.0, 2.0]
    assert read_betas(["-0.5", "1e-3"]).tolist() == [-0.5, 0.001] and read_betas([]).shape == (0,)
    for text in ("betas: [a]", "betas: []", "x: 1", "!!python/object/apply:os.system [echo]", "[1, [2]]", "{", "1"):
        (tmp_path / "bad.yml").write_text(text)
        with pytest.raises(DataError, match=r"bad\.yml"):
            read_betas([str(tmp_path / "bad.yml")])


def test_the_authors_hand_through_the_same_interface(capsys: pytest.CaptureFixture[str]) -> None:
    path = reference_or_skip() / "hand" / "mano_mean.urdf"
    assert main(["hand", "report", str(path), "free"]) == 0
    shown = capsys.readouterr().out
    assert "A mano_mean: 335 g" in shown and "B free: 337 g" in shown
