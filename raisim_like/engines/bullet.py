"""PyBullet behind the engine protocol: worlds, bodies, contacts, pictures."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence

import numpy as np

from raisim_like.contact import Contact
from raisim_like.engines.bullet_pd import ImplicitPd, integrate_worlds
from raisim_like.engines.bullet_shapes import SHAPE_TYPES, collision_filter, geometry, xyzw
from raisim_like.engines.bullet_urdf import compound_urdf, normalised_urdf
from raisim_like.engines.protocol import Array, EngineWorld
from raisim_like.engines.quiet_pybullet import pybullet as p
from raisim_like.errors import EngineError
from raisim_like.material import MaterialTable
from raisim_like.rotations import matrix_from_quaternion, quaternion_from_matrix
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel

# Engine settings, each measured on grasps of 20 objects (docs/physics.md).
SOLVER_ITERATIONS = 100
"""Light objects between ten stiff contacts need this many to stop sinking into the fingers."""
CONTACT_BREAKING_THRESHOLD = 0.001
"""m. Bullet's 0.02 keeps contact points of parts that are centimetres apart and costs 45% of the speed."""

class _Body:
    """A rigid body; Bullet's frame sits at the centre of mass along the principal axes."""

    def __init__(self, uid: int, material: str, com: Array, axes: Array) -> None:
        self.uid, self.material = uid, material
        self.com = com
        self.axes = axes
        self.plain = bool(np.all(com == 0) and np.array_equal(axes, np.eye(3)))


class BulletWorld:
    """One DIRECT client of PyBullet. See `EngineWorld` for the methods."""

    def __init__(self, timestep: float) -> None:
        self.timestep = timestep
        self.step_seconds = 0.0
        self.client = p.connect(p.DIRECT)
        if self.client < 0:
            raise EngineError("PyBullet has no free client left in this process; use more workers")
        self.bodies: dict[int, _Body] = {}
        self.systems: dict[int, ImplicitPd] = {}
        self._system_material: dict[int, str] = {}
        p.setPhysicsEngineParameter(
            fixedTimeStep=timestep,
            numSubSteps=0,
            numSolverIterations=SOLVER_ITERATIONS,
            solverResidualThreshold=0.0,
            enableConeFriction=1,
            # With error reduction, grasps that start inside the object are pushed into holding.
            contactERP=0.0,
            frictionERP=0.0,
            erp=0.0,
            contactBreakingThreshold=CONTACT_BREAKING_THRESHOLD,
            deterministicOverlappingPairs=1,
            # 0: both groups must be in the other's mask; by default one is enough.
            collisionFilterMode=0,
            physicsClientId=self.client,
        )

    def close(self) -> None:
        if self.client >= 0:
            p.disconnect(physicsClientId=self.client)
            self.client = -1

    def set_gravity(self, gravity: Array) -> None:
        p.setGravity(*(float(g) for g in gravity), physicsClientId=self.client)

    # Bodies ------------------------------------------------------------------------------------

    def add_body(
        self, shapes: Sequence[Shape], mass: float, com: Array, inertia: Array, material: str, collision_mask: int
    ) -> int:
        if not shapes:
            raise EngineError("a body needs at least one shape")
        moments, axes = np.linalg.eigh(np.asarray(inertia, dtype=float))
        if np.allclose(inertia, np.diag(np.diag(inertia)), atol=0, rtol=0):
            moments, axes = np.diag(inertia).copy(), np.eye(3)
        elif np.linalg.det(axes) < 0:
            axes[:, 0] *= -1
        for shape in shapes:
            if shape.kind in ("mesh", "hull") and (shape.file is None or not shape.file.is_file()):
                raise EngineError(f"mesh file {shape.file} does not exist")
        if len(shapes) == 1:
            uid = p.createMultiBody(
                baseMass=float(mass),
                baseCollisionShapeIndex=self._collision_shape(shapes[0]),
                baseInertialFramePosition=[float(v) for v in com],
                baseInertialFrameOrientation=xyzw(quaternion_from_matrix(axes)),
                physicsClientId=self.client,
            )
        else:
            # A URDF, for PyBullet's arrays of shapes overflow beyond 16 parts without a word.
            uid = self._load(compound_urdf(shapes, mass, com, axes), p.URDF_USE_INERTIA_FROM_FILE, fixed=False)
        if uid < 0:
            raise EngineError("PyBullet refused the body")
        if mass > 0:
            p.changeDynamics(
                uid,
                -1,
                localInertiaDiagonal=[float(v) for v in moments],
                linearDamping=0.0,
                angularDamping=0.0,
                rollingFriction=0.0,
                spinningFriction=0.0,
                restitution=0.0,
                activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
                physicsClientId=self.client,
            )
        p.setCollisionFilterGroupMask(uid, -1, *collision_filter(collision_mask), physicsClientId=self.client)
        self.bodies[uid] = _Body(uid, material, np.asarray(com, dtype=float), axes)
        return int(uid)

    def _collision_shape(self, shape: Shape) -> int:
        index = p.createCollisionShape(
            SHAPE_TYPES[shape.kind],
            collisionFramePosition=list(shape.position),
            collisionFrameOrientation=xyzw(shape.quaternion),
            physicsClientId=self.client,
            **geometry(shape),
        )
        if index < 0:
            raise EngineError(f"PyBullet refused the collision shape {shape}")
        return int(index)

    def _load(self, text: str, flags: int, fixed: bool) -> int:
        """Load a URDF given as text; the world keeps no file."""
        handle, path = tempfile.mkstemp(suffix=".urdf")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(text)
            return int(p.loadURDF(path, useFixedBase=int(fixed), flags=flags, physicsClientId=self.client))
        except p.error as error:
            raise EngineError(f"PyBullet could not load a body: {error}") from None
        finally:
            os.unlink(path)

    def remove(self, body: int) -> None:
        p.removeBody(body, physicsClientId=self.client)
        self.bodies.pop(body, None)
        self.systems.pop(body, None)
        self._system_material.pop(body, None)

    def apply_materials(self, table: MaterialTable) -> None:
        materials = {uid: body.material for uid, body in self.bodies.items()} | self._system_material
        names = sorted(materials.values())
        touching = {frozenset((a, b)) for i, a in enumerate(names) for b in names[i + 1 :]}
        factors = table.factors(names, touching)
        for uid, material in materials.items():
            for link in range(-1, p.getNumJoints(uid, physicsClientId=self.client)):
                p.changeDynamics(
                    uid, link, lateralFriction=factors[material], restitution=0.0, physicsClientId=self.client
                )

    def set_body_state(self, body: int, state: Array) -> None:
        info = self.bodies[body]
        position, quaternion, linear, angular = state[:3], state[3:7], state[7:10], state[10:13]
        if not info.plain:
            R = matrix_from_quaternion(quaternion)
            offset = R @ info.com
            position = position + offset
            linear = linear + np.cross(angular, offset)
            quaternion = quaternion_from_matrix(R @ info.axes)
        p.resetBasePositionAndOrientation(
            body, [float(v) for v in position], xyzw(quaternion), physicsClientId=self.client
        )
        p.resetBaseVelocity(
            body, [float(v) for v in linear], [float(v) for v in angular], physicsClientId=self.client
        )

    def get_body_state(self, body: int, out: Array) -> None:
        info = self.bodies[body]
        position, (x, y, z, w) = p.getBasePositionAndOrientation(body, physicsClientId=self.client)
        linear, angular = p.getBaseVelocity(body, physicsClientId=self.client)
        out[:3], out[3:7], out[7:10], out[10:13] = position, (w, x, y, z), linear, angular
        if not info.plain:
            R = matrix_from_quaternion(out[3:7]) @ info.axes.T
            offset = R @ info.com
            out[:3] -= offset
            out[3:7] = quaternion_from_matrix(R)
            out[7:10] -= np.cross(out[10:13], offset)

    # Articulated systems -----------------------------------------------------------------------

    def add_articulated(
        self, model: UrdfModel, material: str, collision_mask: int, self_collision: bool, enforce_limits: bool
    ) -> int:
        flags = p.URDF_USE_INERTIA_FROM_FILE
        if self_collision:
            flags |= p.URDF_USE_SELF_COLLISION | p.URDF_USE_SELF_COLLISION_EXCLUDE_ALL_PARENTS
        uid = self._load(normalised_urdf(model, enforce_limits), flags, fixed=True)
        names = [
            p.getJointInfo(uid, i, physicsClientId=self.client)[1].decode()
            for i in range(p.getNumJoints(uid, physicsClientId=self.client))
        ]
        if names != list(model.joint_names):
            raise EngineError(f"PyBullet ordered the joints of {model.path} as {names}")
        for link in range(-1, model.dof):
            p.changeDynamics(
                uid,
                link,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                rollingFriction=0.0,
                spinningFriction=0.0,
                restitution=0.0,
                activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
                physicsClientId=self.client,
            )
            p.setCollisionFilterGroupMask(uid, link, *collision_filter(collision_mask), physicsClientId=self.client)
        self.systems[uid] = ImplicitPd(self.client, uid, model, self.timestep)
        self._system_material[uid] = material
        return int(uid)

    def set_base_pose(self, body: int, position: Array, quaternion: Array) -> None:
        p.resetBasePositionAndOrientation(
            body, [float(v) for v in position], xyzw(quaternion), physicsClientId=self.client
        )

    def set_joint_state(self, body: int, gc: Array, gv: Array) -> None:
        self.systems[body].set_state(gc, gv)

    def get_joint_state(self, body: int, gc: Array, gv: Array) -> None:
        system = self.systems[body]
        gc[:], gv[:] = system.q, system.v

    def set_pd_gains(self, body: int, kp: Array, kd: Array) -> None:
        self.systems[body].set_gains(kp, kd)

    def set_pd_target(self, body: int, target: Array) -> None:
        self.systems[body].target[:] = target

    def set_feed_forward(self, body: int, force: Array) -> None:
        self.systems[body].feed_forward[:] = force

    def mass_matrix(self, body: int) -> Array:
        system = self.systems[body]
        return np.array(p.calculateMassMatrix(body, system.q.tolist(), physicsClientId=self.client))

    def link_poses(self, body: int) -> tuple[Array, Array]:
        states = p.getLinkStates(
            body, range(self.systems[body].dof), computeForwardKinematics=1, physicsClientId=self.client
        )
        quaternions = np.array([(s[5][3], *s[5][:3]) for s in states])
        return matrix_from_quaternion(quaternions), np.array([s[4] for s in states])

    def forget_contacts(self) -> None:
        # Bullet warm-starts its solver from contacts of the past, also over a teleport. Without a pair of
        # bodies near each other the broad phase drops them, and the next episode depends on nothing before it.
        for k, body in enumerate([*self.bodies, *self.systems]):
            p.resetBasePositionAndOrientation(
                body, [0.0, 100.0 * k, 1000.0], [0.0, 0.0, 0.0, 1.0], physicsClientId=self.client
            )
        p.performCollisionDetection(physicsClientId=self.client)

    # Contacts and pictures ---------------------------------------------------------------------

    def link_impulses(self, body: int, other: int, out: Array) -> None:
        out[:] = 0.0
        for point in p.getContactPoints(body, other, physicsClientId=self.client):
            # Bullet keeps several points per pair, some of them almost empty: only their sum means something.
            if point[3] >= 0:
                out[point[3]] += point[9] * self.timestep

    def touching(self, body: int, other: int) -> bool:
        return any(point[9] > 0.0 for point in p.getContactPoints(body, other, physicsClientId=self.client))

    def contacts(self, body: int) -> list[Contact]:
        found = []
        # Asked for one body, Bullet turns pairs round but leaves friction's direction as it was; so ask for all.
        for c in p.getContactPoints(physicsClientId=self.client):
            if body not in (c[1], c[2]):
                continue
            a, b, on_b, sign = (0, 1, c[6], 1.0) if c[1] == body else (1, 0, c[5], -1.0)
            tangential = np.array(c[11]) * c[10] + np.array(c[13]) * c[12]
            found.append(
                Contact(
                    c[1 + a], c[1 + b], c[3 + a], c[3 + b], np.array(on_b), sign * np.array(c[7]), -c[8],
                    c[9] * self.timestep, sign * tangential * self.timestep,
                )
            )  # fmt: skip
        return found

    def render(self, eye: Array, target: Array, width: int, height: int) -> Array:
        view = p.computeViewMatrix([float(v) for v in eye], [float(v) for v in target], [0, 0, 1])
        projection = p.computeProjectionMatrixFOV(40.0, width / height, 0.02, 5.0)
        image = p.getCameraImage(
            width, height, view, projection, renderer=p.ER_TINY_RENDERER, lightDirection=[1, -1, 2],
            physicsClientId=self.client,
        )  # fmt: skip
        return np.reshape(np.asarray(image[2], dtype=np.uint8), (height, width, 4))[..., :3]

    def set_color(self, body: int, rgba: Sequence[float]) -> None:
        for link in range(-1, p.getNumJoints(body, physicsClientId=self.client)):
            p.changeVisualShape(body, link, rgbaColor=list(rgba), physicsClientId=self.client)


class BulletEngine:
    """PyBullet. Its worlds are independent clients; one process may hold many."""

    name = "pybullet"

    def make_world(self, timestep: float) -> EngineWorld:
        return BulletWorld(timestep)

    def integrate(self, worlds: Sequence[EngineWorld], substeps: int) -> None:
        integrate_worlds([w for w in worlds if isinstance(w, BulletWorld)], substeps)


