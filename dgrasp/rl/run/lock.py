"""Lock a run directory: two processes that train in the same one would overwrite each other's checkpoints."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from dgrasp.errors import ConfigError, DataError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

NAME = ".lock"


@contextlib.contextmanager
def only_run(run_dir: Path) -> Iterator[None]:
    """Hold the lock of the run directory; `ConfigError` if another process holds it.

    The operating system releases the lock when its process ends for any reason. Does nothing on Windows.
    """
    if fcntl is None:
        yield
        return
    try:
        run_dir.mkdir(parents=True, exist_ok=True)
        file = os.open(run_dir / NAME, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise DataError(f"{run_dir}: cannot write there ({error.strerror}); choose another --run") from None
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ConfigError(
                f"{run_dir}: another process is training there; wait for it, stop it, or choose another --run"
            ) from None
        yield
    finally:
        os.close(file)


def is_running(run_dir: Path) -> bool:
    """Whether a process on this machine is training in a run directory; False on Windows."""
    if fcntl is None or not (run_dir / NAME).is_file():
        return False
    try:
        file = os.open(run_dir / NAME, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return False
    except OSError:
        return True
    finally:
        os.close(file)
