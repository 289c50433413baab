"""The folders of the files that come with the package, `cfg/` and `data/`, and of those that it makes for a user.

In a checkout, `cfg/` and `data/` are next to the package; in a wheel, they are in `dgrasp/_bundled/`.
"""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path

from dgrasp.errors import DataError

PACKAGE = Path(__file__).resolve().parents[1]
_BUNDLED = PACKAGE / "_bundled"


def is_checkout() -> bool:
    """Whether the package runs from its source tree."""
    # Only a wheel has the bundled folder. A folder data/ next to the package proves nothing in site-packages.
    return not _BUNDLED.is_dir()


def shipped_root() -> Path:
    """The folder that holds `cfg/` and `data/`."""
    return PACKAGE.parent if is_checkout() else _BUNDLED


def data_root() -> Path:
    """The `data/` folder that comes with the package."""
    return shipped_root() / "data"


def cfg_root() -> Path:
    """The folder of the experiments' configurations."""
    return shipped_root() / "cfg"


def user_data_root() -> Path:
    """The folder for users' own data: the checkout's `data/`, or `data/` in the current folder."""
    return data_root() if is_checkout() else Path.cwd() / "data"


def user_cache_root() -> Path:
    """The folder for files that can be made again: DGRASP_CACHE, else the platform's folder for caches.

    A user without a home directory gets a temporary folder that is removed when the process ends.
    """
    if os.environ.get("DGRASP_CACHE"):
        return Path(os.path.expanduser(os.environ["DGRASP_CACHE"])).absolute()
    try:
        return _platform_cache()
    except RuntimeError:  # neither HOME nor an entry in the user database
        return _temporary_cache()


@cache
def _temporary_cache() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="dgrasp-cache-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _platform_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "dgrasp" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "dgrasp"
    # The XDG specification says to ignore a relative path here.
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (base if base.is_absolute() else Path.home() / ".cache") / "dgrasp"


def package_file(relative: str) -> Path:
    """The path of a shipped file such as "cfg/dexycb.yaml"; a `DataError` names what is there instead."""
    path = shipped_root() / relative
    if path.is_file():
        return path
    there = sorted(p.name for p in path.parent.iterdir()) if path.parent.is_dir() else []
    raise DataError(f"{path}: no such file comes with the package; in its folder: {', '.join(there) or 'nothing'}")
