"""Starting worker processes: from which programs that works, with how many threads, and the errors if they die."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from dgrasp.pool.base import PoolError, WorkerLost

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
UNGUARDED = 91
"""Exit code of a worker that ran the user's script, up to the pool, instead of its own work."""
_GUARD = (
    "a worker process runs the script that started it, up to the line that makes the pool; put what the script does "
    'below the line  if __name__ == "__main__":  (or take the pool "serial")'
)


def check_main() -> None:
    """`PoolError` where workers could not start from this program's main module.

    In a worker that runs an unguarded script this ends the process. The pool that started the worker then raises the
    error.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        os._exit(UNGUARDED)
    main = sys.modules.get("__main__")
    file = getattr(main, "__file__", None)
    if file is not None and getattr(main, "__spec__", None) is None and not os.path.isfile(file):
        raise PoolError(f"{file}: worker processes start from the file of the script, and this one has none; save the "
                        'script as a file, put what it does below the line  if __name__ == "__main__":  (or take the '
                        'pool "serial")')


def lost_at_start(lost: WorkerLost) -> PoolError:
    """The error for a worker that died before it had made its environments."""
    return PoolError(_GUARD if lost.exit_code == UNGUARDED else f"{lost}; is there enough memory for its worlds?")


@contextmanager
def single_threaded() -> Iterator[None]:
    """Workers inherit one BLAS thread each: they already share the cores."""
    before = {key: os.environ.get(key) for key in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                del os.environ[key]
            else:
                os.environ[key] = value
