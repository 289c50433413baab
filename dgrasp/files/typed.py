"""Command lines to print, which can be typed as they are."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path


def typed(command: str, words: Iterable[str | Path]) -> str:
    """`python train.py ...` where that file is in the current folder, else `dgrasp train ...`; words are quoted.

    command: train or test.
    """
    start = ["python", f"{command}.py"] if Path(f"{command}.py").is_file() else ["dgrasp", command]
    return shlex.join([*start, *map(str, words)])
