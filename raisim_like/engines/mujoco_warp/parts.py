"""Which worlds have equal models, and what differs between them: masses, inertias, gains."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from raisim_like.batch import Array, WorldSpec
from raisim_like.engines.body_frame import BodyFrame
from raisim_like.engines.mujoco.built import BuiltModel
from raisim_like.engines.mujoco.model import Drive, Item, Solid, System, check_shapes, possible_moments

BATCHED = (
    "body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "jnt_stiffness", "dof_damping", "dof_armature",
    "dof_invweight0",
)  # fmt: skip
"""Arrays of MuJoCo's model that have one row per world."""


def items_of(spec: WorldSpec) -> dict[int, Item]:
    """The systems, then the bodies of a world, by id. Raises `EngineError` for shapes that MuJoCo cannot collide."""
    systems = [
        System(s.model, s.material, s.mask, s.self_collision, s.enforce_limits, Drive(s.model.dof))
        for s in spec.systems
    ]
    solids = []
    for body in spec.bodies:
        check_shapes(body.shapes)
        frame = BodyFrame(body.center_of_mass, body.inertia)
        solids.append(Solid(body.shapes, float(body.mass), frame, body.material, body.mask))
    return dict(enumerate((*systems, *solids)))


def model_key(spec: WorldSpec) -> Hashable:
    """Equal for worlds whose models differ in masses and moments of inertia alone."""
    systems, bodies = [], []
    for body, item in items_of(spec).items():
        if isinstance(item, System):
            # Two URDFs that were read apart count as different: comparing them would take longer than a second model.
            systems.append((body, id(item.urdf), item.material, item.mask, item.self_collision, item.enforce_limits))
        else:
            frame = item.frame
            bodies.append((
                body, item.shapes, frame.com.tobytes(), frame.axes.tobytes(), item.mass > 0.0, item.may_roll,
                item.material, item.mask,
            ))  # fmt: skip
    materials = (spec.materials.default_friction, frozenset(spec.materials.pairs.items()))
    return tuple(systems), tuple(bodies), spec.timestep, spec.preset, spec.gravity, materials


class Constants:
    """The `BATCHED` arrays of worlds with one compiled model, as C MuJoCo derives them.

    masses, moments: (N, B) kg and (N, B, 3) kg m^2 of the bodies. Equal worlds share one computation.
    """

    def __init__(self, built: BuiltModel, items: dict[int, Item], specs: Sequence[WorldSpec]) -> None:
        self.built = built
        self.systems = [(body, item) for body, item in items.items() if isinstance(item, System)]
        self.solids = [body for body, item in items.items() if isinstance(item, Solid)]
        worlds = [items_of(spec) for spec in specs]
        solids = [[item for item in world.values() if isinstance(item, Solid)] for world in worlds]
        self.masses = np.array([[solid.mass for solid in world] for world in solids]).reshape(len(specs), -1)
        self.moments = np.array([[possible_moments(solid.frame.moments) for solid in world] for world in solids])
        self._known: dict[bytes, list[Array]] = {}

    def forget(self) -> None:
        """Drop what was derived; the timestep has changed."""
        self._known = {}

    def of(self, world: int, kp: Array, kd: Array) -> list[Array]:
        """The rows of the `BATCHED` arrays of one world with PD gains kp, kd (dof,)."""
        key = b"".join(part.tobytes() for part in (self.masses[world], self.moments[world], kp, kd))
        if key not in self._known:
            self._known[key] = self._derive(world, kp, kd)
        return self._known[key]

    def _derive(self, world: int, kp: Array, kd: Array) -> list[Array]:
        model, first = self.built.model, 0
        for k, body in enumerate(self.solids):
            bodies = self.built.slots[body].bodies
            if self.masses[world, k] > 0.0:
                model.body_mass[bodies], model.body_inertia[bodies] = self.masses[world, k], self.moments[world, k]
        for body, item in self.systems:
            part = slice(first, first + item.urdf.dof)
            item.drive.kp[:], item.drive.kd[:] = kp[part], kd[part]
            self.built.set_gains(self.built.slots[body], item)
            first = part.stop
        if not self.systems:
            self.built.derive_constants()
        return [np.array(getattr(model, name)) for name in BATCHED]
