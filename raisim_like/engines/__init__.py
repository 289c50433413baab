"""The engines: the only files that import a physics engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import TYPE_CHECKING

from raisim_like.errors import EngineError

if TYPE_CHECKING:
    from raisim_like.engines.protocol import Engine


def default_engine() -> str:
    """PyBullet, the reference; MuJoCo where PyBullet is not installed."""
    return "pybullet" if find_spec("pybullet") else "mujoco"


def _pybullet() -> Engine:
    if find_spec("pybullet") is None:
        raise EngineError(
            "the PyBullet engine needs the package pybullet, which is not installed. It has wheels for Python 3.10 "
            "and 3.11. On others `pip install pybullet==3.2.7` builds it from its source, with a C++ compiler and "
            "Python's headers, in about 7 minutes; or choose the engine mujoco"
        )
    from raisim_like.engines.bullet.engine import BulletEngine

    return BulletEngine()


def _mujoco() -> Engine:
    from raisim_like.engines.mujoco.world import MujocoEngine

    return MujocoEngine()


ENGINES: Mapping[str, Callable[[], Engine]] = {"pybullet": _pybullet, "mujoco": _mujoco}
"""Name of an engine of single worlds -> function that makes it, or raises `EngineError` if a package is missing."""


def make_engine(name: str) -> Engine:
    """The engine of that name. Raises `EngineError` for an unknown name or a missing package."""
    if name not in ENGINES:
        raise EngineError(f"unknown engine {name!r}; expected one of {', '.join(ENGINES)}")
    return ENGINES[name]()


def steps_in_threads(name: str) -> bool:
    """Whether threads of one process can step worlds of this engine side by side."""
    if name != "mujoco":
        return False
    from raisim_like.engines.mujoco.sliding import native

    return native()


def find_warp() -> None:
    """Raise `EngineError` if a package of the engine warp is missing."""
    if find_spec("mujoco_warp") is None or find_spec("warp") is None:
        raise EngineError(
            "the engine warp needs the packages mujoco-warp and warp-lang, which are not installed: "
            "pip install 'dgrasp[warp]'"
        )
