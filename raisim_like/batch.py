"""The interface to an engine: N worlds of one kind that are placed, advanced and read together.

Plain data (`WorldSpec`) describes a world. `WorldBatch` is everything that a task needs from an engine;
`registry.make_batch` makes one. Each row of an array belongs to one world and holds

- the coordinates of the world's systems, one system after the other: `dof` numbers in all;
- the world's bodies, in the order of the specification: `WorldSpec.bodies[k]` is body k.

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
"""Settings of an engine: as close to RaiSim as the engine can be, or faster and less close."""


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
    """A rigid body. A mass of 0 kg makes it static: it stays where it is placed.

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
        """Number of coordinates of all systems together."""
        return sum(system.model.dof for system in self.systems)


@dataclass(frozen=True, eq=False)
class BatchState:
    """State arrays, which the caller owns and a batch writes in place, row by row.

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
    """N worlds on one engine. Their specifications may differ only in shapes, masses and masks.

    An argument of R rows has one row per entry of `rows`; an argument of N rows has one per world. `place`, `move`
    and `advance` update `state` for the rows that they are given and leave the other rows unchanged.
    """

    state: BatchState

    @property
    def seconds(self) -> Array:
        """(N,) wall-clock seconds spent in the engine's own step so far; a batched engine divides them equally."""

    def close(self) -> None:
        """Free all worlds."""

    def place(self, rows: Rows, bases: Array, gc: Array, bodies: Array) -> None:
        """Start the worlds anew, with systems at rest; nothing that happened before affects them.

        bases: (R, S, 7) position and quaternion of each system's base. gc: (R, dof). bodies: (R, B, 13).
        """

    def move(self, rows: Rows, body: int, states: Array) -> None:
        """Set one body to states (R, 13) and leave everything else as it is."""

    def set_gains(self, rows: Rows, kp: Array, kd: Array, feed_forward: Array) -> None:
        """Set PD gains and a constant force per coordinate, (R, dof) each; they hold until they are set again."""

    def advance(self, rows: Rows, targets: Array, substeps: int) -> None:
        """Advance by `substeps` timesteps under PD control towards targets (N, dof)."""

    def link_impulses(self, rows: Rows, body: int, out: Array) -> None:
        """Write the summed normal impulse (N s, last substep) of each system's links against a body, out (N, dof)."""

    def touching(self, rows: Rows, body: int, other: int, out: Array) -> None:
        """Write whether two bodies pressed on each other in the last substep, out (N,): 1 or 0."""

    def broken(self) -> Array:
        """(N,) bool: rows whose state is not finite. They stay broken until `rebuild`."""

    def rebuild(self, rows: Rows) -> None:
        """Replace the worlds of these rows by new ones, which must be placed next. `seconds` keeps counting."""
