"""Mass matrices for the implicit PD (docs/physics.md): the inertia that the engine adds to a hand, and inverses."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from raisim_like.engines.bullet.urdf import simulated_inertias
from raisim_like.engines.floors import LIGHT_INERTIA
from raisim_like.engines.protocol import Array
from raisim_like.urdf import UrdfModel


class Axes:
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
        self.branches, self.ties = _branches(model), model.ties

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

    def response(self, M: Array) -> Array:
        """(N, dof, dof): accelerations per force of systems with mass matrices M (N, dof, dof).

        This is the inverse of M if no joint follows another. Otherwise the free joints' coordinates y give q = P y + b,
        and the accelerations are P (P^T M P)^-1 P^T times the forces.
        """
        if not len(self.ties.followers):
            return inverse(M, self.branches)
        P = self.ties.matrix[:, self.ties.free]
        return np.asarray(P @ np.linalg.inv(P.T @ M @ P) @ P.T)


_AXES: WeakKeyDictionary[UrdfModel, Axes] = WeakKeyDictionary()


def axes_of(model: UrdfModel) -> Axes:
    """The `Axes` of a model, made once per model."""
    if model not in _AXES:
        _AXES[model] = Axes(model)
    return _AXES[model]


def _branches(model: UrdfModel) -> tuple[int, int] | None:
    """(root, size) for a chain of `root` joints from the base, then branches of `size` joints each; else None."""
    parents = [link.parent for link in model.links]
    n = root = len(parents)
    for i in range(1, n):
        if parents[i] != i - 1:
            # The first branch starts at the same link as this joint.
            root = parents[i] + 1
            break
    size = next((i for i in range(root + 1, n) if parents[i] == root - 1), n) - root
    if root in (0, n) or (n - root) % size:
        return None
    starts = range(root, n, size)
    whole = all(parents[s] == root - 1 and all(parents[i] >= s for i in range(s + 1, s + size)) for s in starts)
    return (root, size) if whole else None


def inverse(M: Array, branches: tuple[int, int] | None) -> Array:
    """Inverses of mass matrices (N, dof, dof) of a tree whose branches couple only through its root.

    branches: from `_branches`. The branches of a hand do not couple with each other, so its matrix has the shape of
    an arrow, and block elimination is three times faster than the general inverse that None takes.
    """
    if branches is None:
        return np.linalg.inv(M)
    root, size = branches
    n, dof = len(M), M.shape[-1]
    count = (dof - root) // size
    k = np.arange(count)
    blocks = np.moveaxis(M[:, root:, root:].reshape(n, count, size, count, size)[:, k, :, k], 0, 1)
    C = M[:, root:, :root]
    Fi = np.linalg.inv(blocks)
    Y = np.matmul(Fi, C.reshape(n, count, size, root)).reshape(n, dof - root, root)
    Yt = np.swapaxes(Y, 1, 2)
    X = np.empty_like(M)
    Si = np.linalg.inv(M[:, :root, :root] - np.matmul(np.swapaxes(C, 1, 2), Y))
    X[:, :root, :root] = Si
    X[:, root:, :root] = -np.matmul(Y, Si)
    X[:, :root, root:] = np.swapaxes(X[:, root:, :root], 1, 2)
    X[:, root:, root:] = -np.matmul(X[:, root:, :root], Yt)
    for b in range(count):
        part = slice(root + b * size, root + (b + 1) * size)
        X[:, part, part] += Fi[:, b]
    return X
