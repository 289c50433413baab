"""The engines by name. A new one is a file that implements `WorldBatch` below `engines/`, and a line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol

from raisim_like.batch import BatchState, WorldBatch, WorldSpec
from raisim_like.engines import make_engine
from raisim_like.errors import EngineError
from raisim_like.loop import LoopBatch


class BatchMaker(Protocol):
    """Makes the worlds of a batch, which writes into `state`."""

    def __call__(self, specs: Sequence[WorldSpec], state: BatchState) -> WorldBatch: ...


def _loop(engine: str) -> BatchMaker:
    make_engine(engine)
    return partial(LoopBatch, engine)


BATCHES: Mapping[str, Callable[[], BatchMaker]] = {
    "pybullet": partial(_loop, "pybullet"),
    "mujoco": partial(_loop, "mujoco"),
}
"""By name of the engine: finds its maker. Raises `EngineError` where what it needs is not installed."""


def find_engine(name: str) -> BatchMaker:
    """The maker of batches of that name.

    Raises `EngineError` with the valid names, or with what to install.
    """
    if name not in BATCHES:
        raise EngineError(f"unknown engine {name!r}; expected one of {', '.join(BATCHES)}")
    return BATCHES[name]()


def make_batch(engine: str, specs: Sequence[WorldSpec], state: BatchState) -> WorldBatch:
    """Worlds of these specifications on the engine of that name. Raises as `find_engine` does."""
    return find_engine(engine)(specs, state)
