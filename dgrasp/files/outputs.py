"""Check where a command may write before its work begins, so that no result is lost and no input overwritten."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from dgrasp.errors import DataError


def check_outputs(outputs: Mapping[str, Path], inputs: Iterable[Path | None] = ()) -> None:
    """Raise a `DataError` for an output that cannot be a file, is one of the inputs, or is also another output.

    outputs: name of each output (its option) -> its file.
    """
    taken = {os.path.realpath(path): f"{path}, which is read" for path in inputs if path is not None}
    for name, path in outputs.items():
        folder, real = path.parent, os.path.realpath(path)
        if not os.path.isdir(folder):
            raise DataError(f"{name} {path}: the folder {folder} does not exist")
        if os.path.isdir(path) or (os.path.exists(path) and not os.path.isfile(path)):
            raise DataError(f"{name} {path}: is not a file; expected a file name")
        if real in taken:
            raise DataError(f"{name} {path}: would overwrite {taken[real]}; choose another name")
        if not os.access(path if os.path.isfile(path) else folder, os.W_OK):
            raise DataError(f"{name} {path}: cannot be written; choose another place")
        taken[real] = f"what {name} writes"
