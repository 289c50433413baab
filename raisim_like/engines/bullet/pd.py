"""PD control for PyBullet that behaves like RaiSim's implicit PD (derivation in docs/physics.md).

RaiSim integrates the PD law inside its contact solver, so a contact feels the inertia
M + dt D + dt^2 K: for a finger joint that is 3e-3 kg m^2, a hundred times that of the finger itself. Bullet has no
such term. The law here simulates a hand with inflated link inertias (mass matrix Mb) and adds the torque
that makes it move as the light hand (mass matrix Mr) would under implicit PD:

    Mh = Mr + dt D',  D' = kd + damping + dt kp        inertia and damping of the implicit law
    a  = Mh^-1 (kp (q* - q) + ff + h - D' v)           what the light hand would do
    tau = Mb a - h
    h  += beta (Mb (v+ - v) / dt - tau - h)            observer of contact, limit and gravity forces

With h exact, Mb a = tau + h: the implicit law with every outside force acting on Mh. The observer's lag is
1 / beta substeps.

Each exchange with Bullet costs a good part of a substep, so the law runs once per block of at most `HOLD` engine steps.
It predicts the accelerations of the block's m steps and holds one torque that gives their mean. In all of this, dt is
the engine's step, which the fast preset makes longer than the world's timestep.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from raisim_like.batch import Preset
from raisim_like.engines.bullet.mass import axes_of
from raisim_like.engines.bullet.quiet_pybullet import pybullet as p
from raisim_like.engines.protocol import Array
from raisim_like.urdf import UrdfModel

OBSERVER_GAIN = 0.15
"""beta per timestep. 0.5 was unstable with stiff contacts; a slower observer lets a grip sag."""
HOLD: dict[Preset, int] = {"faithful": 1, "fast": 2}
"""Most engine steps per torque (docs/physics.md)."""
REFRESH_MOTION = 0.1
"""Motion of a joint (rad or m) after which the mass matrices are recomputed; D' outweighs them by far."""


class ImplicitPd:
    """Controller and state of one articulated system; arrays are (dof,)."""

    def __init__(self, client: int, uid: int, model: UrdfModel, timestep: float) -> None:
        self.client, self.uid, self.model, self.dof, self.dt = client, uid, model, model.dof, timestep
        n = self.dof
        self.indices = list(range(n))
        self.axes = axes_of(model)
        self.q, self.v = np.zeros(n), np.zeros(n)
        self.kp, self.kd = np.zeros(n), np.zeros(n)
        self.damping = model.joint_damping
        self.target, self.feed_forward = np.zeros(n), np.zeros(n)
        self.h = np.zeros(n)
        self.Mb, self.X = np.zeros((n, n)), np.zeros((n, n))
        self.forces: list[float] = []
        self.motion: Array = np.zeros((2, n))
        """Coordinates and velocities that Bullet last reported; a view of the batch's array during a call."""
        # Coordinates at which Mb and X = Mh^-1 were computed; infinite where they must be computed.
        self.q_matrices = np.full(n, np.inf)
        p.setJointMotorControlArray(uid, self.indices, p.VELOCITY_CONTROL, forces=[0.0] * n, physicsClientId=client)

    def set_gains(self, kp: Array, kd: Array) -> None:
        if not (np.array_equal(kp, self.kp) and np.array_equal(kd, self.kd)):
            self.kp[:], self.kd[:] = kp, kd
            self.q_matrices[:] = np.inf

    def set_timestep(self, timestep: float) -> None:
        if timestep != self.dt:
            self.dt = timestep
            self.q_matrices[:] = np.inf

    def set_state(self, gc: Array, gv: Array) -> None:
        p.resetJointStatesMultiDof(
            self.uid,
            self.indices,
            targetValues=[[value] for value in np.asarray(gc, dtype=float).tolist()],
            targetVelocities=[[value] for value in np.asarray(gv, dtype=float).tolist()],
            physicsClientId=self.client,
        )
        self.h[:] = 0.0
        self.q[:], self.v[:] = gc, gv
        self.q_matrices[:] = np.inf

    def apply(self) -> None:
        """Send Bullet the torques of the next block."""
        p.setJointMotorControlArray(
            self.uid, self.indices, p.TORQUE_CONTROL, forces=self.forces, physicsClientId=self.client
        )

    def observe(self) -> None:
        """Read coordinates and velocities from Bullet."""
        # Transposing with zip takes half the time of picking both values from each joint's tuple.
        q, v, _, _ = zip(*p.getJointStates(self.uid, self.indices, physicsClientId=self.client), strict=True)
        self.motion[:] = q, v

    @property
    def total_damping(self) -> Array:
        """D' of the implicit law."""
        return self.kd + self.damping + self.dt * self.kp


class ControlBatch:
    """Systems of one model, controlled together for one call of `engine.integrate_worlds`.

    stretch: timesteps per engine step.
    """

    def __init__(self, systems: Sequence[ImplicitPd], stretch: float) -> None:
        self.systems, self.stretch = systems, stretch
        self.dt = systems[0].dt
        self.q = np.array([s.q for s in systems])
        self.v = np.array([s.v for s in systems])
        self.h = np.array([s.h for s in systems])
        self.kp = np.array([s.kp for s in systems])
        self.force = self.kp * [s.target for s in systems] + [s.feed_forward for s in systems]
        self.D = np.array([s.total_damping for s in systems])
        self.wanted = np.zeros_like(self.q)
        self.told = np.zeros((len(systems), 2, self.q.shape[1]))
        for system, row in zip(systems, self.told, strict=True):
            system.motion = row
        self.dt_kp = self.dt * self.kp
        self._refresh()
        self.Mb = np.array([s.Mb for s in systems])
        self.dt_X = self.dt * np.array([s.X for s in systems])

    def _refresh(self) -> None:
        """Recompute the mass matrices of the systems that have moved too far since their last ones."""
        axes = self.systems[0].axes
        moved = np.abs(self.q - [s.q_matrices for s in self.systems])
        rows = np.flatnonzero((moved > REFRESH_MOTION).any(axis=1))
        if not len(rows):
            return
        stale = [self.systems[i] for i in rows.tolist()]
        Mb = np.array([p.calculateMassMatrix(s.uid, s.q.tolist(), physicsClientId=s.client) for s in stale])
        Mh = Mb - axes.added_inertia(self.q[rows])
        diagonal = np.arange(Mh.shape[-1])
        Mh[:, diagonal, diagonal] += self.dt * self.D[rows]
        X = axes.response(Mh)
        for i, s in enumerate(stale):
            s.Mb[:], s.X[:], s.q_matrices[:] = Mb[i], X[i], s.q

    def push(self, steps: int) -> None:
        """Compute the torques of the next block, which the systems then apply."""
        v = self.v.copy()
        # kp (q* - q) + ff - D' v + h, which changes with the motion of each step.
        force = self.force + self.h
        force -= self.kp * self.q
        force -= self.D * v
        for _ in range(steps):
            change = np.matmul(self.dt_X, force[..., None])[..., 0]
            v += change
            change *= self.D
            force -= change
            force -= self.dt_kp * v
        v -= self.v
        v /= steps * self.dt
        self.wanted = v
        tau = np.matmul(self.Mb, v[..., None])[..., 0]
        tau -= self.h
        for s, forces in zip(self.systems, tau.tolist(), strict=True):
            s.forces = forces

    def pull(self, steps: int) -> None:
        """Take over the motion of the block and update the observer."""
        surprise = self.told[:, 1] - self.v
        self.q[:], self.v[:] = self.told[:, 0], self.told[:, 1]
        surprise /= steps * self.dt
        surprise -= self.wanted
        # With tau = Mb wanted - h, the observer's Mb (v+ - v) / dt - tau - h is Mb times the surprise.
        gain = 1.0 - (1.0 - OBSERVER_GAIN) ** (steps * self.stretch)
        self.h += gain * np.matmul(self.Mb, surprise[..., None])[..., 0]

    def store(self) -> None:
        """Write the new state back to the systems."""
        for i, s in enumerate(self.systems):
            s.q[:], s.v[:], s.h[:] = self.q[i], self.v[i], self.h[i]


@cache
def blocks(steps: int, length: float, longest: int) -> tuple[int, ...]:
    """Divide `steps` engine steps of `length` seconds into nearly equal blocks; returns the steps of each block.

    No block is longer than `longest` steps. Bullet divides a block's duration by its number of steps. A number is used
    only if this gives back `length` to the last bit, so that no remainder is left over for the next block.
    """
    exact = [m for m in range(1, longest + 1) if m * length / m == length and int(m * length / length) == m]
    numbers: list[int] = []
    while steps:
        count = -(-steps // longest)
        m = max(m for m in exact if m <= -(-steps // count))
        numbers.append(m)
        steps -= m
    return tuple(numbers)
