"""Pictures for engines whose own renderer needs a display or GL: PyBullet's software renderer draws their bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from raisim_like.engines.bullet.world import BulletWorld
from raisim_like.engines.protocol import Array, EngineWorld
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel


class Picture:
    """Draws the bodies of another engine's world, by their ids there. They are placed but never simulated."""

    def __init__(
        self,
        solids: Mapping[int, Sequence[Shape]],
        systems: Mapping[int, UrdfModel],
        colors: Mapping[int, Sequence[float]],
    ) -> None:
        self._stage = BulletWorld(1.0)
        self._solids = {
            body: self._stage.add_body(shapes, 0.0, np.zeros(3), np.eye(3), "", 0) for body, shapes in solids.items()
        }
        self._systems = {
            body: self._stage.add_articulated(model, "", 0, False, False) for body, model in systems.items()
        }
        self._dof = {body: model.dof for body, model in systems.items()}
        for body, rgba in colors.items():
            self.set_color(body, rgba)

    def close(self) -> None:
        """Free the renderer."""
        self._stage.close()

    def set_color(self, body: int, rgba: Sequence[float]) -> None:
        """Set the colour of a body."""
        self._stage.set_color({**self._solids, **self._systems}[body], rgba)

    def render(
        self, world: EngineWorld, bases: Mapping[int, tuple[Array, Array]], eye: Array, target: Array, width: int,
        height: int,
    ) -> Array:  # fmt: skip
        """(height, width, 3) uint8 picture of the world now. bases: position and quaternion of each system's base."""
        state = np.zeros(13)
        for body, mine in self._solids.items():
            world.get_body_state(body, state)
            self._stage.set_body_state(mine, state)
        for body, mine in self._systems.items():
            gc, gv = np.zeros((2, self._dof[body]))
            world.get_joint_state(body, gc, gv)
            self._stage.set_base_pose(mine, *bases[body])
            self._stage.set_joint_state(mine, gc, gv)
        return self._stage.render(eye, target, width, height)
