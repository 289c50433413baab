"""Write files and folders so that a reader sees the old content or the new, whatever stops the program."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from dgrasp.errors import DataError

TEMPORARY = ".*.tmp"
"""Pattern of the temporary names under which files are first written; a killed process may leave one behind."""


def write_atomic(path: Path, content: bytes | str) -> None:
    """Replace the content of `path` (text as UTF-8) in one step, making its folder if needed.

    The content is on the disk when this returns. If `path` is a link, the link stays and its target is replaced.
    Raises a `DataError` that names the path if it cannot be written, for example on a full disk; the old file then
    stays, and no temporary file remains.
    """
    target = Path(os.path.realpath(path))
    raw = content.encode("utf-8") if isinstance(content, str) else content
    temporary = ""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".tmp")
        with os.fdopen(handle, "wb") as stream:
            stream.write(raw)
            stream.flush()
            os.fsync(stream.fileno())
        # mkstemp makes files that only their owner may read; set the usual mode instead.
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, target)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error}); any existing file is unharmed. "
                        "Free some space or choose another folder") from None
    finally:
        # After the replacement the temporary name is gone; it still exists only if something failed.
        if temporary:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    """Make a new name in a folder survive a power cut; some file systems do not support this."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextlib.contextmanager
def replaced_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder; when the block ends, it takes the place of `path`, with all its files.

    If the block fails, an existing folder stays as it was. Raises a `DataError` that names the path if the folder
    cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}."))
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error})") from None
    old = fresh.with_name(f"{fresh.name}.old")
    try:
        yield fresh
        os.chmod(fresh, 0o755)
        if os.path.lexists(path):
            path.rename(old)
        fresh.rename(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        if old.is_dir() and not os.path.lexists(path):
            old.rename(path)  # Stopped between the two renames: put the old folder back.
        shutil.rmtree(old, ignore_errors=True)
