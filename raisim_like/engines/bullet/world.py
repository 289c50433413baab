"""A PyBullet world that implements the engine protocol: bodies, control, contacts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from weakref import WeakSet

import numpy as np

from raisim_like.batch import Preset
from raisim_like.contact import Contact
from raisim_like.engines.body_frame import BodyFrame
from raisim_like.engines.bullet.bodies import TIED_ERP, keep_ends_apart, make_articulated, make_body
from raisim_like.engines.bullet.contacts import contacts_of, link_impulses, touching
from raisim_like.engines.bullet.friction import factors
from raisim_like.engines.bullet.pd import HOLD, ImplicitPd, blocks
from raisim_like.engines.bullet.quiet_pybullet import pybullet as p
from raisim_like.engines.bullet.rest import (
    BREAKING_THRESHOLD,
    DAMPING,
    LEAST_FRICTION,
    ROLLING_FRICTION,
    ROLLING_FRICTION_OF_FACES,
    STIFFNESS,
    may_roll,
)
from raisim_like.engines.bullet.shapes import xyzw
from raisim_like.engines.bullet.state import BulletSnapshot
from raisim_like.engines.pending import Pending
from raisim_like.engines.protocol import Array, engine_steps
from raisim_like.errors import EngineError
from raisim_like.material import MaterialTable
from raisim_like.rotations import matrix_from_quaternion
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel

# Engine settings, each measured on grasps of 20 objects (docs/physics.md).
SOLVER_ITERATIONS = 100
"""With fewer, light objects between ten stiff contacts sink into the fingers."""
LIGHT, LIGHT_ITERATIONS = 0.05, 500
"""A mass in kg, and the solver's iterations in a world that has a lighter moving body. Under the implicit law, an
object feels a finger as half a kilogram, and the solver converges more slowly the more two masses differ."""
RESIDUAL: dict[Preset, float] = {"faithful": 0.0, "fast": 1e-7}
"""Change per iteration at which the solver stops. 1e-7 holds the same grasps as 0 but lets blocks creep on slopes."""
CONTACT_BREAKING_THRESHOLD = 0.001
"""m. Bullet's default of 0.02 keeps contact points of parts that are centimetres apart and costs 45% of the speed."""


class _Body:
    """A rigid body, which Bullet simulates in its inertial frame."""

    def __init__(self, material: str, frame: BodyFrame, mass: float, shapes: Sequence[Shape]) -> None:
        self.material, self.frame, self.mass = material, frame, mass
        self.rolls = may_roll(shapes, mass, frame)
        self.rolls_on_faces = self.rolls and any(shape.kind == "hull" for shape in shapes)


class BulletWorld:
    """One DIRECT client of PyBullet. See `EngineWorld` for the methods."""

    _threshold_in_use = 0.0

    def __init__(self, timestep: float, preset: Preset = "faithful") -> None:
        self.timestep, self.preset = timestep, preset
        self.step_seconds = 0.0
        self.client = p.connect(p.DIRECT)
        if self.client < 0:
            raise EngineError("PyBullet has no free client left in this process; use more workers")
        self.bodies: dict[int, _Body] = {}
        self.systems: dict[int, ImplicitPd] = {}
        self._system_material: dict[int, str] = {}
        self._friction: dict[str, float] = {}
        self._springs = False
        self._set_solver()
        p.setPhysicsEngineParameter(
            enableConeFriction=1,
            # With error reduction, grasps that start inside the object would be pushed into a hold.
            contactERP=0.0,
            frictionERP=0.0,
            deterministicOverlappingPairs=1,
            # 0: each group must be in the other's mask; by default one match is enough.
            collisionFilterMode=0,
            physicsClientId=self.client,
        )
        BulletWorld._threshold_in_use = 0.0
        self._snapshots = WeakSet[BulletSnapshot]()
        self._pending, self._lasting = Pending(), dict[int, Array]()
        self._block = 0, 0.0
        self.set_block(1, timestep)

    @property
    def _impulse_per_force(self) -> float:
        """Seconds that turn a reported force into the impulse of one timestep.

        Bullet reports the impulses of its last step divided by the duration of the whole call.
        """
        return self._block[0] * self.timestep

    def set_block(self, steps: int, length: float) -> None:
        """Make Bullet take `steps` steps of `length` seconds per call."""
        if (steps, length) != self._block:
            p.setPhysicsEngineParameter(fixedTimeStep=steps * length, numSubSteps=steps, physicsClientId=self.client)
            self._block = steps, length

    def use_threshold(self) -> None:
        """Bullet has one contact breaking threshold for all clients of a process; this world's is set before a step."""
        if BulletWorld._threshold_in_use != self._threshold:
            p.setPhysicsEngineParameter(contactBreakingThreshold=self._threshold, physicsClientId=self.client)
            BulletWorld._threshold_in_use = self._threshold

    def bare_step(self, substeps: int) -> float:
        self.use_threshold()
        seconds = 0.0
        total, length = engine_steps(substeps, self.timestep, self.preset)
        for steps in blocks(total, length, HOLD[self.preset]):
            # Bullet drops torques after every step, and a grasp with limp fingers would be a different problem.
            for system in self.systems.values():
                if system.forces:
                    system.apply()
            self.set_block(steps, length)
            start = time.perf_counter()
            p.stepSimulation(physicsClientId=self.client)
            seconds += time.perf_counter() - start
        return seconds

    def close(self) -> None:
        if self.client >= 0:
            for snapshot in self._snapshots:
                snapshot.world_closed()
            p.disconnect(physicsClientId=self.client)
            self.client = -1

    def set_gravity(self, gravity: Array) -> None:
        p.setGravity(*(float(g) for g in gravity), physicsClientId=self.client)

    # Bodies ------------------------------------------------------------------------------------

    def add_body(
        self, shapes: Sequence[Shape], mass: float, com: Array, inertia: Array, material: str, collision_mask: int
    ) -> int:
        frame = BodyFrame(com, inertia)
        uid = make_body(self.client, shapes, mass, frame, collision_mask)
        self.bodies[uid] = _Body(material, frame, mass, shapes)
        self._set_solver()
        self._keep_ends_apart()
        return uid

    def _keep_ends_apart(self) -> None:
        if any(body.rolls for body in self.bodies.values()):
            keep_ends_apart(self.client, [*(u for u, body in self.bodies.items() if body.mass > 0), *self.systems])

    def _set_solver(self) -> None:
        """Settings that depend on the bodies that there are."""
        light = any(0.0 < body.mass < LIGHT for body in self.bodies.values())
        rolls = any(body.rolls for body in self.bodies.values())
        p.setPhysicsEngineParameter(
            numSolverIterations=LIGHT_ITERATIONS if light else SOLVER_ITERATIONS,
            # A solver that stops early leaves torques that set a round body rolling.
            solverResidualThreshold=0.0 if rolls else RESIDUAL[self.preset],
            erp=TIED_ERP if any(len(system.model.ties.followers) for system in self.systems.values()) else 0.0,
            physicsClientId=self.client,
        )
        self._threshold = BREAKING_THRESHOLD if rolls else CONTACT_BREAKING_THRESHOLD
        self._set_rolling()

    def _set_rolling(self) -> None:
        """Rolling friction and spring of static bodies. Bullet multiplies the first by the other body's coefficient."""
        least = min((self._friction.get(b.material, 1.0) for b in self.bodies.values() if b.rolls), default=0.0)
        faces = any(body.rolls_on_faces for body in self.bodies.values())
        rolling = ROLLING_FRICTION_OF_FACES if faces else ROLLING_FRICTION
        rolling = rolling / max(least, LEAST_FRICTION) if least else 0.0
        # Bullet cannot take a spring off again; one without stiffness leaves contacts as they are without one.
        self._springs = self._springs or least > 0.0
        spring = {"contactStiffness": STIFFNESS * (least > 0.0), "contactDamping": DAMPING} if self._springs else {}
        for uid, body in self.bodies.items():
            if body.mass == 0:
                p.changeDynamics(uid, -1, rollingFriction=rolling, physicsClientId=self.client, **spring)

    def remove(self, body: int) -> None:
        p.removeBody(body, physicsClientId=self.client)
        self._pending.forget(body)
        self.bodies.pop(body, None)
        self.systems.pop(body, None)
        self._system_material.pop(body, None)
        self._set_solver()

    def apply_materials(self, table: MaterialTable) -> None:
        materials = {uid: body.material for uid, body in self.bodies.items()} | self._system_material
        names = sorted(materials.values())
        pairs = {frozenset((a, b)) for i, a in enumerate(names) for b in names[i + 1 :]}
        coefficients = factors(table, names, pairs)
        for uid, material in materials.items():
            for link in range(-1, p.getNumJoints(uid, physicsClientId=self.client)):
                p.changeDynamics(
                    uid, link, lateralFriction=coefficients[material], restitution=0.0, physicsClientId=self.client
                )
        self._friction = coefficients
        self._set_rolling()

    def set_body_state(self, body: int, state: Array) -> None:
        inertial = [float(v) for v in self.bodies[body].frame.to_inertial(state)]
        p.resetBasePositionAndOrientation(body, inertial[:3], xyzw(inertial[3:7]), physicsClientId=self.client)
        p.resetBaseVelocity(body, inertial[7:10], inertial[10:], physicsClientId=self.client)

    def get_body_state(self, body: int, out: Array) -> None:
        position, (x, y, z, w) = p.getBasePositionAndOrientation(body, physicsClientId=self.client)
        linear, angular = p.getBaseVelocity(body, physicsClientId=self.client)
        out[:3], out[3:7], out[7:10], out[10:13] = position, (w, x, y, z), linear, angular
        self.bodies[body].frame.from_inertial(out)

    # Articulated systems -----------------------------------------------------------------------

    def add_articulated(
        self, model: UrdfModel, material: str, collision_mask: int, self_collision: bool, enforce_limits: bool
    ) -> int:
        uid = make_articulated(self.client, model, collision_mask, self_collision, enforce_limits)
        self.systems[uid] = ImplicitPd(self.client, uid, model, self.timestep)
        self._system_material[uid] = material
        self._set_solver()
        self._keep_ends_apart()
        return uid

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

    def apply_wrench(self, body: int, force: Array, torque: Array) -> None:
        self._pending.add_wrench(body, force, torque)

    def apply_generalized_force(self, body: int, force: Array) -> None:
        self._pending.add_generalized(body, force)

    def begin_pending(self) -> bool:
        """Apply the pending forces, which act until `end_pending`. Returns whether there are any."""
        for body, (force, torque) in self._pending.wrenches.items():
            position, _ = p.getBasePositionAndOrientation(body, physicsClientId=self.client)
            p.applyExternalForce(body, -1, force.tolist(), position, p.WORLD_FRAME, physicsClientId=self.client)
            p.applyExternalTorque(body, -1, torque.tolist(), p.WORLD_FRAME, physicsClientId=self.client)
        for body, extra in self._pending.generalized.items():
            system = self.systems[body]
            self._lasting[body] = system.feed_forward.copy()
            system.feed_forward += extra
        return bool(self._pending)

    def end_pending(self) -> None:
        """Remove the pending forces; Bullet itself has dropped those on rigid bodies."""
        for body, force in self._lasting.items():
            self.systems[body].feed_forward[:] = force
        self._lasting, self._pending = {}, Pending()

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
        # Bullet warm-starts its solver from past contacts, even after a teleport. With all bodies far apart, the
        # broad phase drops those contacts, so that the next episode does not depend on anything before it.
        for k, body in enumerate([*self.bodies, *self.systems]):
            p.resetBasePositionAndOrientation(
                body, [0.0, 100.0 * k, 1000.0], [0.0, 0.0, 0.0, 1.0], physicsClientId=self.client
            )
        self.use_threshold()
        p.performCollisionDetection(physicsClientId=self.client)

    # Contacts ---------------------------------------------------------------------------------

    def link_impulses(self, body: int, other: int, out: Array) -> None:
        link_impulses(self.client, body, other, self._impulse_per_force, out)

    def touching(self, body: int, other: int) -> bool:
        return touching(self.client, body, other)

    def contacts(self, body: int) -> list[Contact]:
        return contacts_of(self.client, body, self._impulse_per_force, self.bodies)

    def save(self) -> BulletSnapshot:
        snapshot = BulletSnapshot(self.client, set(self.bodies), self.systems, self._block, self._pending.copy())
        self._snapshots.add(snapshot)
        # Bullet does not restore exactly what it saved: contacts have fewer points. Restoring here makes this run
        # continue in the same way as the runs after a later restore.
        self.restore(snapshot)
        return snapshot

    def restore(self, snapshot: BulletSnapshot) -> None:
        if (set(self.bodies), set(self.systems)) != (snapshot.bodies, set(snapshot.arrays)):
            raise EngineError("bodies were added or removed since the snapshot was taken")
        self.set_block(*snapshot.block)
        # Otherwise the order of the contacts, and with it the rounding, would depend on the steps since the snapshot.
        self.forget_contacts()
        snapshot.write_back(self.systems)
        self._pending = snapshot.pending.copy()
