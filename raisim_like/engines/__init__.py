"""The engines: the only files that import a physics engine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from raisim_like.errors import EngineError

if TYPE_CHECKING:
    from raisim_like.engines.protocol import Engine

ENGINES = ("pybullet",)


def make_engine(name: str) -> Engine:
    """The engine of that name; raises `EngineError` with the valid names."""
    if name == "pybullet":
        from raisim_like.engines.bullet import BulletEngine

        return BulletEngine()
    raise EngineError(f"unknown engine {name!r}; expected one of {', '.join(ENGINES)}")
