"""Write files so that a reader sees the old content or the new one, never a part."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from dgrasp.errors import DataError


def write_atomic(path: Path, content: bytes | str) -> None:
    """Replace `path` by `content` (text as UTF-8) in one step, making its folder where needed.

    Raises `DataError` naming the path where it cannot be written; nothing is left behind then.
    """
    # What a link points to is replaced, not the link.
    path = Path(os.path.realpath(path))
    raw = content.encode("utf-8") if isinstance(content, str) else content
    temporary = ""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(handle, "wb") as stream:
            stream.write(raw)
        # mkstemp makes files for their owner alone; give the usual mode instead.
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        # After the replacement the temporary name is gone; it still exists only where something failed.
        if temporary and os.path.exists(temporary):
            os.unlink(temporary)
