"""The engines by name. To add one, implement `WorldBatch` in a file below `engines/` and add a line to `BATCHES`.

An engine of single worlds implements `Engine` instead; a line in `engines.ENGINES` is then enough.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol

from raisim_like.batch import BatchState, WorldBatch, WorldSpec
from raisim_like.engines import ENGINES, make_engine
from raisim_like.errors import EngineError
from raisim_like.loop import LoopBatch


class BatchMaker(Protocol):
    """Makes a batch of worlds that writes into `state`. threads: see `make_batch`."""

    def __call__(self, specs: Sequence[WorldSpec], state: BatchState, threads: int = 1) -> WorldBatch: ...


def _loop(engine: str) -> BatchMaker:
    make_engine(engine)
    return partial(LoopBatch, engine)


BATCHES: Mapping[str, Callable[[], BatchMaker]] = {
    **{name: partial(_loop, name) for name in ENGINES},
}
"""Name of an engine -> function that returns its maker, or raises `EngineError` if a package is not installed."""
CONCAVE_MESHES = ("pybullet",)
"""The engines that collide concave triangle meshes; the others take convex parts."""
AT_ONCE: Mapping[str, int] = {"pybullet": 128}
"""Engine -> most worlds to have at once; the others take any number. A PyBullet world takes 29 MB, and one process has
at most 1024 of them."""


def in_parts(count: int, engine: str, most: int | None = None) -> list[slice]:
    """Slices of `count` worlds, of about equal size: each is simulated at once, one after another.

    A slice has at most `AT_ONCE` worlds of the engine, and at most `most`. No world: one empty slice.
    """
    size = min(AT_ONCE.get(engine, max(1, count)), most or max(1, count))
    parts = max(1, -(-count // size))
    return [slice(k * count // parts, (k + 1) * count // parts) for k in range(parts)]


def find_engine(name: str) -> BatchMaker:
    """The maker of batches for the engine of that name.

    Raises `EngineError` for an unknown name, with the valid names, and for a missing package, with what to install.
    """
    if name not in BATCHES:
        raise EngineError(f"unknown engine {name!r}; expected one of {', '.join(BATCHES)}")
    return BATCHES[name]()


def make_batch(engine: str, specs: Sequence[WorldSpec], state: BatchState, threads: int = 1) -> WorldBatch:
    """A batch of worlds with these specifications on the engine of that name. Raises the errors of `find_engine`.

    threads: how many worlds may step side by side, on an engine that can (`engines.steps_in_threads`).
    """
    return find_engine(engine)(specs, state, threads)
