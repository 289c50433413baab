"""A world's bodies as a specification of MuJoCo, with the solver's settings (docs/physics.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement
from typing import Any

import mujoco as mj
import numpy as np

from raisim_like.batch import Preset
from raisim_like.engines.body_frame import BodyFrame
from raisim_like.engines.floors import LIGHT_INERTIA, MIN_MASS
from raisim_like.engines.mujoco.collision import chains, collision_bits
from raisim_like.engines.mujoco.sliding import MARK
from raisim_like.engines.mujoco.ties import add_ties
from raisim_like.engines.protocol import Array
from raisim_like.errors import EngineError
from raisim_like.material import MaterialTable
from raisim_like.rotations import quaternion_from_matrix
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel

CONTACT_MARGIN = 1e-4
"""Distance at which contacts begin, m. At 0, bodies that lie on each other separate and touch in turns."""
TOLERANCE = {"faithful": 1e-8, "fast": 1e-3}
"""Tolerance of the contact solver; 1e-8 is MuJoCo's. At 1e-3 it needs two Newton iterations instead of three, and
grasps hold as well."""
CYLINDER_TOLERANCE = 1e-9
"""Tolerance of collisions in worlds with cylinders that turn easily, m. At MuJoCo's 1e-6 the contact of a lying bar is
0.03 mm beside its centre, and the bar rolls away (docs/physics.md, "Rest")."""
ROLLING_FRICTION = 2e-5
"""Rolling friction between such a cylinder and static bodies, m. It holds against the rest of the error."""
IMPEDANCE = 0.9999
"""Hardness of contacts and limits; MuJoCo caps it at this value. The difference to 1 makes grasps creep."""

_GEOMS = {
    "box": mj.mjtGeom.mjGEOM_BOX,
    "sphere": mj.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mj.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mj.mjtGeom.mjGEOM_CAPSULE,
    "hull": mj.mjtGeom.mjGEOM_MESH,
}


@dataclass
class Solid:
    """A rigid body as requested; static if its mass is 0."""

    shapes: tuple[Shape, ...]
    mass: float
    frame: BodyFrame
    material: str
    mask: int

    @property
    def may_roll(self) -> bool:
        """Whether it has a cylinder and turns easily."""
        return self.frame.turns_easily(self.mass) and any(shape.kind == "cylinder" for shape in self.shapes)


class Drive:
    """PD gains, target and feed-forward force of an articulated system; arrays are (dof,)."""

    def __init__(self, dof: int) -> None:
        self.kp, self.kd, self.target, self.feed_forward = np.zeros((4, dof))

    def copy(self, other: Drive) -> None:
        """Take over the values of another drive of the same system."""
        for name, array in vars(self).items():
            array[:] = getattr(other, name)


@dataclass
class System:
    """An articulated system as requested, and its drive."""

    urdf: UrdfModel
    material: str
    mask: int
    self_collision: bool
    enforce_limits: bool
    drive: Drive


Item = Solid | System


class ModelMaker:
    """Fills an MjSpec; `elements` holds the MjSpec bodies of each body id, an articulated system's base first."""

    def __init__(
        self, items: Mapping[int, Item], materials: MaterialTable, timestep: float, gravity: Array, preset: Preset
    ) -> None:
        self.items, self.materials = items, materials
        self.spec = mj.MjSpec()
        self.spec.compiler.degree = False
        self.spec.add_numeric(name=MARK, data=[1.0])
        option = self.spec.option
        option.timestep, option.gravity, option.tolerance = timestep, gravity, TOLERANCE[preset]
        # Fingers couple only through palm and object, so this is a third faster than dense, with the same solution.
        option.cone, option.jacobian = mj.mjtCone.mjCONE_ELLIPTIC, mj.mjtJacobian.mjJAC_SPARSE
        # The armature already holds the implicit damping. A broken world must stay broken, so that its owner sees it.
        # Searching for islands does not pay off where a hand connects everything.
        off = mj.mjtDisableBit
        option.disableflags = off.mjDSBL_EULERDAMP | off.mjDSBL_AUTORESET | off.mjDSBL_ISLAND
        if any(isinstance(item, Solid) and item.may_roll for item in items.values()):
            option.ccd_tolerance = CYLINDER_TOLERANCE
        # No spring, and a damper that stops the approach within one step: inelastic, without error reduction.
        self.solref, self.solimp = solref(timestep), [IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2.0]
        self.bits = collision_bits(
            {body: item.mask for body, item in items.items()},
            {body: item.self_collision for body, item in items.items() if isinstance(item, System)},
        )
        self.meshes: dict[tuple[str, tuple[float, ...]], str] = {}
        self.geoms: dict[int, list[tuple[str, int]]] = {body: [] for body in items}
        self.elements: dict[int, list[Any]] = {
            body: self._solid(body, item) if isinstance(item, Solid) else self._system(body, item)
            for body, item in items.items()
        }
        self._pairs()

    def _solid(self, body: int, item: Solid) -> list[Any]:
        world = self.spec.worldbody
        if item.mass > 0:
            moments = possible_moments(item.frame.moments)
            element = world.add_body(name=f"b{body}", mass=item.mass, inertia=moments, explicitinertial=True)
            element.add_freejoint()
        else:
            # A "mocap" body stays where it is placed.
            element = world.add_body(name=f"b{body}", mocap=True)
        for shape in item.shapes:
            self._geom(element, body, -1, item.frame.shape_in_inertial(shape))
        return [element]

    def _system(self, body: int, item: System) -> list[Any]:
        elements = [self.spec.worldbody.add_body(name=f"b{body}", mocap=True)]
        links = item.urdf.links
        frames = [BodyFrame(link.com, link.inertia) for link in links]
        # Convert all at once: one by one, these conversions would take most of the time to make a world.
        turns = quaternion_from_matrix(np.array([link.origin[:3, :3] for link in links]))
        axes = quaternion_from_matrix(np.array([frame.axes for frame in frames]))
        for i, (link, frame) in enumerate(zip(links, frames, strict=True)):
            element = elements[link.parent + 1].add_body(
                name=f"b{body} link{i}",
                pos=link.origin[:3, 3],
                quat=turns[i],
                mass=max(link.mass, MIN_MASS),
                ipos=frame.com,
                iquat=axes[i],
                inertia=possible_moments(np.maximum(frame.moments, LIGHT_INERTIA)),
                explicitinertial=True,
            )
            element.add_joint(
                name=f"b{body} joint{i}",
                type=mj.mjtJoint.mjJNT_SLIDE if link.kind == "prismatic" else mj.mjtJoint.mjJNT_HINGE,
                axis=link.axis,
                limited=item.enforce_limits and link.mimic is None and bool(np.isfinite(link.lower)),
                range=np.nan_to_num([link.lower, link.upper]),
                solref_limit=self.solref,
                solimp_limit=self.solimp,
            )
            for shape in link.shapes:
                self._geom(element, body, i, shape)
            elements.append(element)
        add_ties(self.spec, item.urdf, [f"b{body} joint{i}" for i in range(len(links))], self.solimp)
        if item.self_collision:
            # Links never collide with the links above them; MuJoCo itself excludes only the direct parent.
            for i, j in chains(item.urdf):
                self.spec.add_exclude(bodyname1=elements[i + 1].name, bodyname2=elements[j + 1].name)
        return elements

    def _geom(self, element: Any, body: int, link: int, shape: Shape) -> None:
        contype, conaffinity = self.bits[body]
        name = f"b{body} geom{len(self.geoms[body])}"
        self.geoms[body].append((name, link))
        element.add_geom(
            name=name,
            type=_GEOMS[shape.kind],
            pos=shape.position,
            quat=shape.quaternion,
            contype=contype,
            conaffinity=conaffinity,
            condim=3,
            friction=[self.materials.default_friction, 0.0, 0.0],
            solref=self.solref,
            solimp=self.solimp,
            margin=CONTACT_MARGIN,
            **self._geometry(shape),
        )

    def _geometry(self, shape: Shape) -> dict[str, Any]:
        if shape.kind == "hull":
            key = (str(shape.file), shape.scale)
            if key not in self.meshes:
                self.meshes[key] = f"mesh{len(self.meshes)}"
                # The bodies have explicit inertias; the mesh's own only has to exist.
                self.spec.add_mesh(name=self.meshes[key], file=key[0], scale=shape.scale,
                                   inertia=mj.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
            return {"meshname": self.meshes[key]}
        size = [v / 2 for v in shape.size]
        if shape.kind != "box":
            size[0] = shape.size[0]
        return {"size": [*size, 0.0, 0.0][:3]}

    def _pairs(self) -> None:
        """Add the pairs of geoms with a friction of their own; others have the larger value of both, the default."""
        for a, b in combinations_with_replacement(self.items, 2):
            friction = self.materials.friction(self.items[a].material, self.items[b].material)
            rolls = self._rolls_on(a, b) or self._rolls_on(b, a)
            if (friction == self.materials.default_friction and not rolls) or not self.bits[a][0] & self.bits[b][1]:
                continue
            rolling = ROLLING_FRICTION if rolls else 0.0
            for first, second in self._touching(a, b):
                self.spec.add_pair(
                    geomname1=first, geomname2=second, condim=6 if rolls else 3,
                    friction=[friction, friction, 0.0, rolling, rolling],
                    solref=self.solref, solimp=self.solimp, margin=CONTACT_MARGIN,
                )  # fmt: skip

    def _rolls_on(self, a: int, b: int) -> bool:
        """Whether `a` is a cylinder that may roll and `b` is static."""
        item, other = self.items[a], self.items[b]
        return isinstance(item, Solid) and item.may_roll and isinstance(other, Solid) and other.mass == 0.0

    def _touching(self, a: int, b: int) -> list[tuple[str, str]]:
        """Pairs of geoms, one of each body, that may collide."""
        item, other = self.items[a], self.items[b]
        if isinstance(item, Solid) and isinstance(other, Solid) and (a == b or item.mass == other.mass == 0.0):
            # MuJoCo would make contacts for such a pair although its bodies cannot move.
            return []
        if a != b or isinstance(item, Solid):
            return [(first, second) for first, _ in self.geoms[a] for second, _ in self.geoms[b]]
        apart = chains(item.urdf)
        return [
            (first, second)
            for (first, i), (second, j) in combinations(self.geoms[a], 2)
            if i != j and (i, j) not in apart and (j, i) not in apart
        ]


def check_shapes(shapes: Sequence[Shape]) -> None:
    """Raise `EngineError` for shapes that MuJoCo cannot collide."""
    if not shapes:
        raise EngineError("a body needs at least one shape")
    for shape in shapes:
        if shape.kind == "mesh":
            raise EngineError(
                f"{shape.file}: MuJoCo has no concave meshes and would take the convex hull; give the body convex "
                "parts instead, one shape of kind 'hull' for each"
            )
        if shape.kind == "hull" and (shape.file is None or not shape.file.is_file()):
            raise EngineError(f"mesh file {shape.file} does not exist")


def solref(timestep: float) -> list[float]:
    """No spring, and a damper that stops an approach within one step."""
    return [0.0, -1.0 / timestep]


def possible_moments(moments: Array) -> Array:
    """Principal moments of inertia (3,), the smallest raised to what a solid can have, as MuJoCo requires."""
    low, middle, high = np.argsort(moments)
    raised = np.array(moments)
    raised[low] = max(moments[low], (moments[high] - moments[middle]) * (1.0 + 1e-9))
    return raised
