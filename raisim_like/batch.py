"""The door to an engine: N worlds of one kind, placed, advanced and read together.

A world is described by plain data (`WorldSpec`). `WorldBatch` is all that an engine has to offer to a task;
`registry.make_batch` makes one. Worlds are the rows of all arrays. Each row holds

- the coordinates of its systems, one system after the other: `dof` numbers in all;
- its bodies, in the order of the specification: `WorldSpec.bodies[k]` is body k.

Arrays are float64, SI, world frame; quaternions are w, x, y, z. A body's state is (13,): position, quaternion,
linear and angular velocity of its frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from raisim_like.material import MaterialTable
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel

Array = NDArray[Any]
Rows = Sequence[int]

Preset = Literal["faithful", "fast"]
"""Settings of an engine: as near to RaiSim as it gets, or faster where that costs some of it."""


@dataclass(frozen=True, eq=False)
class SystemSpec:
    """An articulated system on a fixed base.

    mask: see `world.collision_mask`. enforce_limits: whether the engine stops joints at their limits.
    """

    model: UrdfModel
    material: str
    mask: int
    self_collision: bool = False
    enforce_limits: bool = True


@dataclass(frozen=True, eq=False)
class BodySpec:
    """A rigid body; with a mass of 0 kg it is static, and stays where it is put.

    inertia: (3, 3) kg m^2 about the centre of mass (3,) m, both in the body's frame.
    """

    shapes: tuple[Shape, ...]
    mass: float
    inertia: Array
    center_of_mass: Array
    material: str
    mask: int


@dataclass(frozen=True, eq=False)
class WorldSpec:
    """What is in a world and how it is simulated. timestep: s. gravity: (3,) m/s^2."""

    systems: tuple[SystemSpec, ...]
    bodies: tuple[BodySpec, ...]
    timestep: float
    preset: Preset = "faithful"
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    materials: MaterialTable = field(default_factory=MaterialTable)

    @property
    def dof(self) -> int:
        """Coordinates of all systems together."""
        return sum(system.model.dof for system in self.systems)


@dataclass(frozen=True, eq=False)
class BatchState:
    """What a batch writes in place, row by row; the arrays stay the caller's.

    gc, gv: (N, dof) coordinates and velocities. bodies: (N, B, 13).
    """

    gc: Array
    gv: Array
    bodies: Array

    def broken(self) -> Array:
        """(N,) bool: rows in which a number is infinite or NaN."""
        finite = np.isfinite(self.gc).all(axis=1)
        finite &= np.isfinite(self.gv).all(axis=1)
        finite &= np.isfinite(self.bodies).all(axis=(1, 2))
        return np.asarray(~finite)


class WorldBatch(Protocol):
    """N worlds on one engine, whose specifications agree in all but shapes, masses and masks.

    Arguments of R rows hold one row per entry of `rows`, arguments of N rows one per world. After `place`, `move`
    and `advance`, `state` is true for the rows that they were given; other rows are left as they are.
    """

    state: BatchState

    @property
    def seconds(self) -> Array:
        """(N,) wall seconds spent inside the engine's own step so far; a batched engine divides them equally."""

    def close(self) -> None:
        """Free all worlds."""

    def place(self, rows: Rows, bases: Array, gc: Array, bodies: Array) -> None:
        """Begin anew, systems at rest: what follows does not depend on what was before.

        bases: (R, S, 7) position and quaternion of each system's base. gc: (R, dof). bodies: (R, B, 13).
        """

    def move(self, rows: Rows, body: int, states: Array) -> None:
        """Put one body to states (R, 13) while all else goes on."""

    def set_gains(self, rows: Rows, kp: Array, kd: Array, feed_forward: Array) -> None:
        """PD gains and a constant force of the coordinates, (R, dof) each; they hold until they are set again."""

    def advance(self, rows: Rows, targets: Array, substeps: int) -> None:
        """Advance by so many timesteps under PD control towards targets (N, dof)."""

    def link_impulses(self, rows: Rows, body: int, out: Array) -> None:
        """Write the summed normal impulse (N s, last substep) of each system's links against a body, out (N, dof)."""

    def touching(self, rows: Rows, body: int, other: int, out: Array) -> None:
        """Write whether two bodies pressed on each other in the last substep, out (N,): 1 or 0."""

    def broken(self) -> Array:
        """(N,) bool: rows whose state is not finite. They stay so until `rebuild`."""

    def rebuild(self, rows: Rows) -> None:
        """Make the worlds of these rows anew; they are to be placed next. Seconds are kept."""
