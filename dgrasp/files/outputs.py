"""Where a command may write: checked before the work begins, so that nothing is lost or overwritten after it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from dgrasp.errors import DataError


def check_outputs(outputs: Mapping[str, Path], inputs: Iterable[Path | None] = ()) -> None:
    """Raise a `DataError` for an output that cannot be a file, is one of the inputs, or is another output too.

    outputs: what each is called (its option) -> the file.
    """
    taken = {os.path.realpath(path): f"{path}, which is read" for path in inputs if path is not None}
    for name, path in outputs.items():
        folder, real = path.parent, os.path.realpath(path)
        if not os.path.isdir(folder):
            raise DataError(f"{name} {path}: the folder {folder} does not exist")
        if os.path.isdir(path) or (os.path.exists(path) and not os.path.isfile(path)):
            raise DataError(f"{name} {path}: is no file; expected the name of one")
        if real in taken:
            raise DataError(f"{name} {path}: would overwrite {taken[real]}; choose another name")
        if not os.access(path if os.path.isfile(path) else folder, os.W_OK):
            raise DataError(f"{name} {path}: cannot be written; choose another place")
        taken[real] = f"what {name} writes"
