"""A world of bodies, and the integration of several worlds together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raisim_like.articulated_system import ArticulatedSystem
from raisim_like.batch import Preset, WorldSpec
from raisim_like.engines import default_engine, make_engine
from raisim_like.errors import EngineError
from raisim_like.material import MaterialTable
from raisim_like.rigid_body import RigidBody, vector3
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel, read_urdf

Array = NDArray[Any]

# Collision bits: the low byte says what a body is, the next byte what it collides with.
STATIC, BODY, SYSTEM = 1, 2, 4


@dataclass(frozen=True)
class Snapshot:
    """An opaque snapshot, which `World.save` returns and `World.restore` takes."""

    world: World
    engine_state: Any
    gravity: Array
    time: float


def collision_mask(kind: int, collides_with: int) -> int:
    """Mask for `World.add_*`: a kind (STATIC, BODY, SYSTEM) and the kinds that it collides with."""
    return kind | collides_with << 8


class World:
    """A simulated world (RaiSim's `World`). Gravity is (0, 0, -9.81) m/s^2 until it is set.

    timestep: s. preset: "faithful" is as close to RaiSim as the engine can be, "fast" trades some of that for speed.
    """

    def __init__(self, engine: str | None = None, timestep: float = 0.00222, preset: Preset = "faithful") -> None:
        if not timestep > 0:
            raise ValueError(f"timestep must be positive, got {timestep}")
        self.engine = make_engine(engine or default_engine())
        self.engine_world = self.engine.make_world(timestep, preset)
        self.timestep = timestep
        self.materials = MaterialTable()
        self.objects: list[RigidBody | ArticulatedSystem] = []
        self.set_gravity((0.0, 0.0, -9.81))
        self.world_time = 0.0

    @classmethod
    def from_spec(cls, spec: WorldSpec, engine: str | None = None) -> World:
        """Make a world from a specification; its `objects` are the systems, then the bodies."""
        world = cls(engine, spec.timestep, spec.preset)
        world.set_gravity(spec.gravity)
        world.materials = MaterialTable(spec.materials.default_friction, dict(spec.materials.pairs))
        for system in spec.systems:
            world.add_articulated_system(
                system.model, system.material, system.mask, system.self_collision, system.enforce_limits
            )
        for body in spec.bodies:
            world.add_body(body.shapes, body.mass, body.inertia, body.center_of_mass, body.material, body.mask)
        return world

    def close(self) -> None:
        """Free the engine's world; the object is unusable afterwards."""
        self.engine_world.close()

    def set_gravity(self, gravity: Any) -> None:
        """Set gravity, (3,) m/s^2, world."""
        self._gravity = vector3(gravity, "gravity")
        self.engine_world.set_gravity(self._gravity)

    @property
    def gravity(self) -> Array:
        """(3,) m/s^2, world."""
        return self._gravity.copy()

    def set_material_pair(self, first: str, second: str, friction: float) -> None:
        """Set the friction between two materials; it applies to all bodies immediately."""
        self.materials.set_pair(first, second, friction)
        self.engine_world.apply_materials(self.materials)

    def set_default_material(self, friction: float) -> None:
        """Set the friction of all pairs that are not set by name."""
        self.materials.default_friction = float(friction)
        self.engine_world.apply_materials(self.materials)

    def add_body(
        self,
        shapes: Sequence[Shape],
        mass: float,
        inertia: Any,
        center_of_mass: Any = (0.0, 0.0, 0.0),
        material: str = "default",
        mask: int | None = None,
    ) -> RigidBody:
        """Add a rigid body of one or more shapes; mass 0 makes it static. inertia (3, 3) kg m^2 about the com."""
        if not (math.isfinite(mass) and mass >= 0.0):
            raise ValueError(f"a mass of {mass} kg; expected a finite number, at least 0 (0: a static body)")
        if mask is None:
            mask = collision_mask(BODY if mass > 0 else STATIC, STATIC | BODY | SYSTEM)
        body = self.engine_world.add_body(
            shapes, mass, np.asarray(center_of_mass, dtype=float), np.asarray(inertia, dtype=float), material, mask
        )
        self.engine_world.apply_materials(self.materials)
        made = RigidBody(self, body, mass, np.array(center_of_mass, dtype=float), np.array(inertia, dtype=float))
        self.objects.append(made)
        return made

    def add_box(self, x: float, y: float, z: float, mass: float, material: str = "default") -> RigidBody:
        """Add a solid box with full side lengths, m."""
        inertia = mass / 12 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
        return self.add_body([Shape("box", (x, y, z))], mass, inertia, material=material)

    def add_sphere(self, radius: float, mass: float, material: str = "default") -> RigidBody:
        """Add a solid sphere; radius in m."""
        return self.add_body([Shape("sphere", (radius,))], mass, 0.4 * mass * radius**2 * np.eye(3), material=material)

    def add_cylinder(self, radius: float, length: float, mass: float, material: str = "default") -> RigidBody:
        """Add a solid cylinder along z; radius and length in m."""
        side = mass * (3 * radius**2 + length**2) / 12
        inertia = np.diag([side, side, mass * radius**2 / 2])
        return self.add_body([Shape("cylinder", (radius, length))], mass, inertia, material=material)

    def add_ground(self, height: float = 0.0, material: str = "default") -> RigidBody:
        """Add a large static slab whose top is at `height`, m."""
        body = self.add_body([Shape("box", (20.0, 20.0, 1.0))], 0.0, np.eye(3), material=material)
        body.set_state((0.0, 0.0, height - 0.5))
        return body

    def add_articulated_system(
        self,
        urdf: UrdfModel | Path | str,
        material: str = "default",
        mask: int | None = None,
        self_collision: bool = False,
        enforce_limits: bool = True,
    ) -> ArticulatedSystem:
        """Add an articulated system on a fixed base, from a URDF.

        enforce_limits: whether the engine stops joints at their limits. A system whose targets stay within the limits
        does not need this, and Bullet is half as fast with dozens of joints at their stops.
        """
        model = urdf if isinstance(urdf, UrdfModel) else read_urdf(urdf)
        if mask is None:
            mask = collision_mask(SYSTEM, STATIC | BODY | SYSTEM)
        body = self.engine_world.add_articulated(model, material, mask, self_collision, enforce_limits)
        self.engine_world.apply_materials(self.materials)
        made = ArticulatedSystem(self, body, model)
        self.objects.append(made)
        return made

    def remove(self, item: RigidBody | ArticulatedSystem) -> None:
        """Remove a body or system from the world."""
        self.engine_world.remove(item.id)
        self.objects.remove(item)

    def get_object(self, name: str) -> RigidBody | ArticulatedSystem:
        """The first object with that `name`. Raises `ValueError`, with the existing names, if there is none."""
        for item in self.objects:
            if item.name == name:
                return item
        raise ValueError(f"no object is named {name!r}; there are {sorted({o.name for o in self.objects if o.name})}")

    def save(self) -> Snapshot:
        """Snapshot of everything that moves or drives: states, controllers, contacts, pending forces, gravity and time.

        Materials and the set of bodies are not included.
        """
        return Snapshot(self, self.engine_world.save(), self.gravity, self.world_time)

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this world. What follows is identical to the bit each time.

        Raises `EngineError` for a snapshot of another world, or if bodies were added or removed since.
        """
        if snapshot.world is not self:
            raise EngineError("this snapshot belongs to another world")
        self.engine_world.restore(snapshot.engine_state)
        self.set_gravity(snapshot.gravity)
        self.world_time = snapshot.time

    def integrate(self, substeps: int = 1) -> None:
        """Advance by `substeps` timesteps."""
        integrate([self], substeps)


def integrate(worlds: Sequence[World], substeps: int = 1, threads: int = 1) -> None:
    """Advance several worlds of one engine together, so that their control is batched.

    threads: how many of them may step side by side (see `engines.steps_in_threads`); the result is the same to the bit.
    """
    if not worlds:
        return
    engine = worlds[0].engine
    if any(world.engine.name != engine.name for world in worlds):
        raise EngineError("worlds of different engines cannot be integrated together")
    engine.integrate([world.engine_world for world in worlds], substeps, threads)
    for world in worlds:
        world.world_time += substeps * world.timestep
