"""PD control for PyBullet that feels like RaiSim's implicit PD (derivation in docs/physics.md).

RaiSim integrates the PD law inside its contact solver, so a contact feels the inertia
M + dt D + dt^2 K: for a finger joint that is 3e-3 kg m^2, a hundred times the finger itself. Bullet has no
such term. The law here simulates a hand with inflated link inertias (mass matrix Mb) and adds the torque
that makes it move as the light hand (mass matrix Mr) would under implicit PD:

    Mh = Mr + dt D',  D' = kd + damping + dt kp        inertia and damping of the implicit law
    G  = Mb Mh^-1
    tau = G (kp (q* - q) + ff + h - D' v) - h
    h  += beta (Mb (v+ - v) / dt - tau - h)            observer of contact, limit and gravity forces

With h exact, Mb a = tau + h gives Mh a = kp (q* - q) + ff + h - D' v: the implicit law with every outside
force acting on Mh. The observer's lag is 1 / beta substeps.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from operator import itemgetter
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from raisim_like.engines.bullet_urdf import LIGHT_INERTIA, simulated_inertias
from raisim_like.engines.protocol import Array
from raisim_like.engines.quiet_pybullet import pybullet as p
from raisim_like.urdf import UrdfModel

if TYPE_CHECKING:
    from raisim_like.engines.bullet import BulletWorld

OBSERVER_GAIN = 0.15
"""beta per substep. 0.5 went unstable on stiff contacts; a slower observer lets a grip sag."""


class _Axes:
    """Directions of all joint axes in the base frame, for many configurations at once."""

    def __init__(self, model: UrdfModel) -> None:
        n = model.dof
        self.revolute = np.array([link.kind == "revolute" for link in model.links])
        self.axis = np.array([link.axis for link in model.links])
        self.origin = np.array([link.origin[:3, :3] for link in model.links])
        x, y, z = self.axis.T
        zero = np.zeros(n)
        K = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(n, 3, 3)
        self.cross, self.cross2 = K, K @ K
        depth: list[int] = []
        for link in model.links:
            depth.append(0 if link.parent < 0 else depth[link.parent] + 1)
        parents = np.array([link.parent for link in model.links])
        self.levels = [
            (ids, parents[ids]) for d in range(max(depth) + 1) if len(ids := np.flatnonzero(np.array(depth) == d))
        ]
        # common[i, j]: inertia added to the links that both joint i and joint j turn.
        added = simulated_inertias(model) - LIGHT_INERTIA
        common = np.zeros((n, n))
        for i in range(n):
            ancestors = []
            k = i
            while k >= 0:
                if self.revolute[k]:
                    ancestors.append(k)
                k = model.links[k].parent
            common[np.ix_(ancestors, ancestors)] += added[i]
        self.common = common

    def __call__(self, q: Array) -> Array:
        """(N, dof, 3) axis directions for coordinates (N, dof); zero for prismatic joints."""
        angle = np.where(self.revolute, q, 0.0)[..., None, None]
        local = self.origin @ (np.eye(3) + np.sin(angle) * self.cross + (1.0 - np.cos(angle)) * self.cross2)
        R = np.empty_like(local)
        for ids, parents in self.levels:
            R[:, ids] = local[:, ids] if parents[0] < 0 else np.matmul(R[:, parents], local[:, ids])
        axes = np.matmul(R, self.axis[:, :, None])[..., 0]
        return np.where(self.revolute[:, None], axes, 0.0)

    def added_inertia(self, q: Array) -> Array:
        """(N, dof, dof): mass matrix of the inflated link inertias alone, Mb - Mr."""
        a = self(q)
        return np.matmul(a, np.swapaxes(a, -1, -2)) * self.common


_AXES: WeakKeyDictionary[UrdfModel, _Axes] = WeakKeyDictionary()


def _axes_of(model: UrdfModel) -> _Axes:
    if model not in _AXES:
        _AXES[model] = _Axes(model)
    return _AXES[model]


class ImplicitPd:
    """Controller and state of one articulated system; arrays are (dof,)."""

    def __init__(self, client: int, uid: int, model: UrdfModel, timestep: float) -> None:
        self.client, self.uid, self.model, self.dof, self.dt = client, uid, model, model.dof, timestep
        n = self.dof
        self.indices = list(range(n))
        self.axes = _axes_of(model)
        self.q, self.v = np.zeros(n), np.zeros(n)
        self.kp, self.kd = np.zeros(n), np.zeros(n)
        self.damping = model.joint_damping
        self.target, self.feed_forward = np.zeros(n), np.zeros(n)
        self.h = np.zeros(n)
        p.setJointMotorControlArray(
            uid, self.indices, p.VELOCITY_CONTROL, forces=[0.0] * n, physicsClientId=client
        )

    def set_gains(self, kp: Array, kd: Array) -> None:
        self.kp[:], self.kd[:] = kp, kd

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


_VELOCITY = itemgetter(1)
CHUNK = 8
"""Worlds stepped in turn, substep by substep: enough to batch their algebra, few enough for the cache."""


class _Batch:
    """Systems of one model, controlled together for one control step."""

    def __init__(self, systems: Sequence[ImplicitPd]) -> None:
        self.systems, first = systems, systems[0]
        self.dt = dt = first.dt
        self.q = np.array([s.q for s in systems])
        self.v = np.array([s.v for s in systems])
        self.h = np.array([s.h for s in systems])
        self.kp = np.array([s.kp for s in systems])
        self.target = np.array([s.target for s in systems])
        self.forward = np.array([s.feed_forward for s in systems])
        self.D = np.array([s.kd + s.damping + dt * s.kp for s in systems])
        self.tau = np.zeros_like(self.q)
        self.Mb = np.array([p.calculateMassMatrix(s.uid, s.q.tolist(), physicsClientId=s.client) for s in systems])
        Mh = self.Mb - first.axes.added_inertia(self.q)
        Mh[:, range(first.dof), range(first.dof)] += dt * self.D
        # Both are symmetric, so G = Mb Mh^-1 is the transpose of Mh^-1 Mb.
        self.G = np.swapaxes(np.linalg.solve(Mh, self.Mb), -1, -2)

    def push(self) -> None:
        """The torques of the next substep."""
        wanted = self.kp * (self.target - self.q) + self.forward + self.h - self.D * self.v
        self.tau = np.matmul(self.G, wanted[..., None])[..., 0] - self.h
        for s, forces in zip(self.systems, self.tau.tolist(), strict=True):
            p.setJointMotorControlArray(
                s.uid, s.indices, p.TORQUE_CONTROL, forces=forces, physicsClientId=s.client
            )

    def pull(self) -> None:
        """What the substep did, and what the observer learns from it."""
        before = self.v
        self.v = np.array(
            [
                list(map(_VELOCITY, p.getJointStates(s.uid, s.indices, physicsClientId=s.client)))
                for s in self.systems
            ]
        )
        # Bullet moves one-dof joints by exactly this, so the positions need not be read.
        self.q += self.dt * self.v
        accelerations = ((self.v - before) / self.dt)[..., None]
        self.h += OBSERVER_GAIN * (np.matmul(self.Mb, accelerations)[..., 0] - self.tau - self.h)

    def store(self) -> None:
        """Gives the systems their new state."""
        for i, s in enumerate(self.systems):
            s.q[:], s.v[:], s.h[:] = self.q[i], self.v[i], self.h[i]


def integrate_worlds(worlds: Sequence[BulletWorld], substeps: int) -> None:
    """Advance worlds together: the linear algebra of their controllers is batched, the steps are not."""
    for first in range(0, len(worlds), CHUNK):
        _integrate_chunk(worlds[first : first + CHUNK], substeps)


def _integrate_chunk(worlds: Sequence[BulletWorld], substeps: int) -> None:
    groups: dict[tuple[int, float], list[ImplicitPd]] = {}
    for world in worlds:
        for system in world.systems.values():
            groups.setdefault((id(system.model), system.dt), []).append(system)
    batches = [_Batch(group) for group in groups.values()]
    clock = time.perf_counter
    for _ in range(substeps):
        for batch in batches:
            batch.push()
        for world in worlds:
            start = clock()
            p.stepSimulation(physicsClientId=world.client)
            world.step_seconds += clock() - start
        for batch in batches:
            batch.pull()
    for batch in batches:
        batch.store()
