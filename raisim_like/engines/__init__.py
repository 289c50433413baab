"""The engines: the only files that import a physics engine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from raisim_like.errors import EngineError

if TYPE_CHECKING:
    from raisim_like.engines.protocol import Engine

ENGINES = ("pybullet", "mujoco")


def make_engine(name: str) -> Engine:
    """The engine of that name. Raises `EngineError` for an unknown name or a missing package."""
    if name == "pybullet":
        from raisim_like.engines.bullet.engine import BulletEngine

        return BulletEngine()
    if name == "mujoco":
        try:
            import mujoco  # noqa: F401
        except ImportError:
            raise EngineError(
                "the MuJoCo engine needs the package mujoco, which is not installed; run: "
                "pip install 'mujoco>=3.17,<4' (the extra dgrasp[mujoco] is the same), or choose the engine pybullet"
            ) from None
        from raisim_like.engines.mujoco.world import MujocoEngine

        return MujocoEngine()
    raise EngineError(f"unknown engine {name!r}; expected one of {', '.join(ENGINES)}")
