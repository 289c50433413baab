"""A world's bodies as a MuJoCo model, built in memory, with the settings of the solver (docs/physics.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement
from typing import Any

import mujoco as mj
import numpy as np

from raisim_like.batch import Preset
from raisim_like.engines.body_frame import BodyFrame
from raisim_like.engines.floors import LIGHT_INERTIA, MIN_MASS
from raisim_like.engines.mujoco.collision import chains, collision_bits
from raisim_like.engines.protocol import Array
from raisim_like.errors import EngineError
from raisim_like.material import MaterialTable
from raisim_like.rotations import quaternion_from_matrix
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel

CONTACT_MARGIN = 1e-4
"""m. Contacts begin this early; at 0, bodies that lie on each other part and meet in turns."""
TOLERANCE = {"faithful": 1e-8, "fast": 1e-3}
"""Of the contact solver; 1e-8 is MuJoCo's. At 1e-3 Newton needs two iterations, not three, and grasps hold as well."""
CYLINDER_TOLERANCE = 1e-9
"""m, to which collisions are found in worlds with cylinders that turn easily. At MuJoCo's 1e-6 the contact of a lying
bar is 0.03 mm beside its centre, and the bar rolls away (docs/physics.md, "Rest")."""
ROLLING_FRICTION = 2e-5
"""m, between such a cylinder and what is static; it holds against what is left of the error."""
IMPEDANCE = 0.9999
"""How hard contacts and limits are; MuJoCo caps it here. What is missing to 1 makes grasps creep."""

_GEOMS = {
    "box": mj.mjtGeom.mjGEOM_BOX,
    "sphere": mj.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mj.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mj.mjtGeom.mjGEOM_CAPSULE,
    "hull": mj.mjtGeom.mjGEOM_MESH,
}


@dataclass
class Solid:
    """A rigid body as it was asked for; static when its mass is 0."""

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
    """What drives an articulated system; arrays are (dof,)."""

    def __init__(self, dof: int) -> None:
        self.kp, self.kd, self.target, self.feed_forward = np.zeros((4, dof))


@dataclass
class System:
    """An articulated system as it was asked for, and what drives it."""

    urdf: UrdfModel
    material: str
    mask: int
    self_collision: bool
    enforce_limits: bool
    drive: Drive


Item = Solid | System


@dataclass(frozen=True)
class Slot:
    """Where a body is in MuJoCo's arrays: qpos, qvel, joints, moving bodies; mocap -1 for a free body."""

    q: slice
    v: slice
    joints: slice
    bodies: slice
    mocap: int


class BuiltModel:
    """A compiled model with its data, and who is who in it.

    owner, link: (ngeom,) body id and moving-link index (-1 for none) of each geom.
    """

    def __init__(
        self, items: Mapping[int, Item], materials: MaterialTable, timestep: float, gravity: Array, preset: Preset
    ) -> None:
        maker = _Maker(items, materials, timestep, gravity, preset)
        try:
            self.model = maker.spec.compile()
        except ValueError as error:
            raise EngineError(f"MuJoCo refused a body: {' '.join(str(error).split())}") from None
        self.data = mj.MjData(self.model)
        owner, link = np.full(self.model.nbody, -1), np.full(self.model.nbody, -1)
        self.slots: dict[int, Slot] = {}
        for body, elements in maker.elements.items():
            ids = [element.id for element in elements]
            self.slots[body] = self._slot(ids)
            owner[ids], link[ids] = body, range(-1, len(ids) - 1)
        self.owner, self.link = owner[self.model.geom_bodyid], link[self.model.geom_bodyid]

    def _slot(self, ids: list[int]) -> Slot:
        m = self.model
        first, stop = ids[0], ids[-1] + 1
        mocap = int(m.body_mocapid[first])
        moving = first + 1 if mocap >= 0 else first
        if moving == stop:
            return Slot(slice(0), slice(0), slice(0), slice(0), mocap)
        joint, v = int(m.body_jntadr[moving]), int(m.body_dofadr[moving])
        q, n = int(m.jnt_qposadr[joint]), stop - moving
        if mocap < 0:
            return Slot(slice(q, q + 7), slice(v, v + 6), slice(joint, joint + 1), slice(moving, stop), mocap)
        return Slot(slice(q, q + n), slice(v, v + n), slice(joint, joint + n), slice(moving, stop), mocap)

    def set_timestep(self, timestep: float) -> None:
        """Another timestep, for all that depends on it but the gains."""
        m = self.model
        m.opt.timestep = timestep
        for solref in (m.geom_solref, m.jnt_solref, m.pair_solref):
            solref[:] = _solref(timestep)

    def set_gains(self, slot: Slot, item: System) -> None:
        """PD control of a system: springs and dampers in the joints, and the armature that makes them implicit."""
        m, dt = self.model, self.model.opt.timestep
        D = item.drive.kd + item.urdf.joint_damping + dt * item.drive.kp
        m.jnt_stiffness[slot.joints] = item.drive.kp
        m.dof_damping[slot.v], m.dof_armature[slot.v] = D, dt * D
        # The hardness of contacts is relative to inertias that MuJoCo computes beforehand; this spoils its data.
        mj.mj_setConst(m, mj.MjData(m))


class _Maker:
    """Fills an MjSpec; `elements` are the MjSpec bodies of each body id, an articulated system's base first."""

    def __init__(
        self, items: Mapping[int, Item], materials: MaterialTable, timestep: float, gravity: Array, preset: Preset
    ) -> None:
        self.items, self.materials = items, materials
        self.spec = mj.MjSpec()
        self.spec.compiler.degree = False
        option = self.spec.option
        option.timestep, option.gravity, option.tolerance = timestep, gravity, TOLERANCE[preset]
        # Fingers do not couple but through palm and object: a third faster than dense, to the same solution.
        option.cone, option.jacobian = mj.mjtCone.mjCONE_ELLIPTIC, mj.mjtJacobian.mjJAC_SPARSE
        # The armature holds the implicit damping already. A world that broke stays so, for its owner to see.
        # Looking for islands does not pay where a hand holds everything together.
        off = mj.mjtDisableBit
        option.disableflags = off.mjDSBL_EULERDAMP | off.mjDSBL_AUTORESET | off.mjDSBL_ISLAND
        if any(isinstance(item, Solid) and item.may_roll for item in items.values()):
            option.ccd_tolerance = CYLINDER_TOLERANCE
        # No spring, and a damper that stops the approach within one step: inelastic, without error reduction.
        self.solref, self.solimp = _solref(timestep), [IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2.0]
        self.bits = collision_bits(
            {body: item.mask for body, item in items.items()},
            {body: item.self_collision for body, item in items.items() if isinstance(item, System)},
        )
        self.meshes: dict[str, str] = {}
        self.geoms: dict[int, list[tuple[str, int]]] = {body: [] for body in items}
        self.elements: dict[int, list[Any]] = {
            body: self._solid(body, item) if isinstance(item, Solid) else self._system(body, item)
            for body, item in items.items()
        }
        self._pairs()

    def _solid(self, body: int, item: Solid) -> list[Any]:
        world = self.spec.worldbody
        if item.mass > 0:
            moments = _possible(item.frame.moments)
            element = world.add_body(name=f"b{body}", mass=item.mass, inertia=moments, explicitinertial=True)
            element.add_freejoint()
        else:
            # What is "mocap" stands still wherever it is put.
            element = world.add_body(name=f"b{body}", mocap=True)
        for shape in item.shapes:
            self._geom(element, body, -1, item.frame.shape_in_inertial(shape))
        return [element]

    def _system(self, body: int, item: System) -> list[Any]:
        elements = [self.spec.worldbody.add_body(name=f"b{body}", mocap=True)]
        links = item.urdf.links
        frames = [BodyFrame(link.com, link.inertia) for link in links]
        # At once, for one by one these conversions are what a new world waits for.
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
                inertia=_possible(np.maximum(frame.moments, LIGHT_INERTIA)),
                explicitinertial=True,
            )
            element.add_joint(
                type=mj.mjtJoint.mjJNT_SLIDE if link.kind == "prismatic" else mj.mjtJoint.mjJNT_HINGE,
                axis=link.axis,
                limited=item.enforce_limits and bool(np.isfinite(link.lower)),
                range=np.nan_to_num([link.lower, link.upper]),
                solref_limit=self.solref,
                solimp_limit=self.solimp,
            )
            for shape in link.shapes:
                self._geom(element, body, i, shape)
            elements.append(element)
        if item.self_collision:
            # Links never collide with what they hang on; MuJoCo itself knows the nearest parent alone.
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
            file = str(shape.file)
            if file not in self.meshes:
                self.meshes[file] = f"mesh{len(self.meshes)}"
                # Inertias are given; the mesh's own only has to exist.
                self.spec.add_mesh(name=self.meshes[file], file=file, inertia=mj.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
            return {"meshname": self.meshes[file]}
        size = [v / 2 for v in shape.size]
        if shape.kind != "box":
            size[0] = shape.size[0]
        return {"size": [*size, 0.0, 0.0][:3]}

    def _pairs(self) -> None:
        """Pairs of geoms with a friction of their own; for the others MuJoCo takes the larger one, the default."""
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
            # MuJoCo would ask no further about bodies that cannot move.
            return []
        if a != b or isinstance(item, Solid):
            return [(first, second) for first, _ in self.geoms[a] for second, _ in self.geoms[b]]
        apart = chains(item.urdf)
        return [
            (first, second)
            for (first, i), (second, j) in combinations(self.geoms[a], 2)
            if i != j and (i, j) not in apart and (j, i) not in apart
        ]


def _solref(timestep: float) -> list[float]:
    """No spring, and a damper that stops what approaches within one step."""
    return [0.0, -1.0 / timestep]


def _possible(moments: Array) -> Array:
    """Principal moments of inertia, the smallest raised to what a solid can have, as MuJoCo asks."""
    low, middle, high = np.argsort(moments)
    raised = np.array(moments)
    raised[low] = max(moments[low], (moments[high] - moments[middle]) * (1.0 + 1e-9))
    return raised
