"""Outputs are checked before any work, and what is there stays until the new file is whole."""

from __future__ import annotations

import errno
import os
import stat
import sys
from pathlib import Path
from typing import Any

import pytest

from dgrasp.errors import DataError
from dgrasp.files.atomic import replaced_folder, write_atomic
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
        ({"--json": tmp_path / "b"}, "is not a file"),
        ({"--json": tmp_path / "none" / "a.json"}, "does not exist"),
        ({"--json": Path(os.devnull)}, "is not a file"),
        ({"--json": Path("")}, "is not a file"),
    ):
        with pytest.raises(DataError, match=said):
            check_outputs(outputs, [label])


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "real.txt")
    write_atomic(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink() and (tmp_path / "real.txt").read_text() == "new"


def test_a_written_file_has_the_usual_mode_and_its_folder_is_made(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_atomic(tmp_path / "new" / "folder" / "a.txt", "\u00e4\n")
    finally:
        os.umask(before)
    file = tmp_path / "new" / "folder" / "a.txt"
    assert file.read_bytes() == b"\xc3\xa4\n" and stat.S_IMODE(file.stat().st_mode) == 0o640


def test_file_and_folder_are_on_the_disk_when_it_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[bool] = []
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(stat.S_ISDIR(os.fstat(handle).st_mode)))
    write_atomic(tmp_path / "a.txt", b"new")
    assert synced == [False, True]


@pytest.mark.parametrize("function", ["fsync", "replace", "chmod"])
def test_full_disk_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: str) -> None:
    def fail(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / "file"
    write_atomic(path, b"old")
    monkeypatch.setattr(os, function, fail)
    with pytest.raises(DataError, match=r"file: cannot be written \(No space left on device\); .* is unharmed\. Free "):
        write_atomic(path, b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["file"] and path.read_bytes() == b"old"


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits on the size of files")
def test_write_that_stops_half_way_keeps_the_old_file(tmp_path: Path) -> None:
    import resource

    path = tmp_path / "file"
    write_atomic(path, b"old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(DataError, match="cannot be written"):
            write_atomic(path, bytes(200_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [p.name for p in tmp_path.iterdir()] == ["file"] and path.read_bytes() == b"old"


def test_interrupted_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    path = tmp_path / "file"
    write_atomic(path, b"old")
    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_atomic(path, b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["file"] and path.read_bytes() == b"old"


def test_a_folder_is_replaced_with_all_its_files(tmp_path: Path) -> None:
    for content in ("old", "new"):
        with replaced_folder(tmp_path / "a" / "b") as fresh:
            (fresh / f"{content}.txt").write_text(content)
    assert [p.name for p in (tmp_path / "a").rglob("*")] == ["b", "new.txt"]
    assert stat.S_IMODE((tmp_path / "a" / "b").stat().st_mode) == 0o755


@pytest.mark.parametrize("error", [KeyboardInterrupt, DataError, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))])
def test_a_folder_that_is_not_finished_keeps_the_old_one(tmp_path: Path, error: Any) -> None:
    with replaced_folder(tmp_path / "a") as fresh:
        (fresh / "old.txt").write_text("old")
    with (
        pytest.raises(DataError if isinstance(error, OSError) else error) as caught,
        replaced_folder(tmp_path / "a") as fresh,
    ):
        (fresh / "new.txt").write_text("new")
        raise error
    assert [p.name for p in tmp_path.rglob("*")] == ["a", "old.txt"]
    if isinstance(error, OSError):
        assert str(caught.value) == f"{tmp_path / 'a'}: cannot be written (No space left on device)"
