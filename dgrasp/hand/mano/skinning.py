"""Batched forward skinning of a hand in MANO's layout, by the same code in numpy and in torch.

Linear blend skinning with shape and pose blend shapes (MANO: Romero, Tzionas and Black, "Embodied hands", 2017,
section 3). Joints and rotations are in the order of `skeleton.PARTS`, key points in that of `skeleton.KEYPOINTS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from dgrasp.hand.mano.model import PART_TO_MANO, ManoModel
from dgrasp.hand.mano.skeleton import N_PARTS, PART_PARENT

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True, eq=False)
class HandSkin:
    """The data that skinning needs of a model with V vertices and S shape parameters, as numpy arrays or torch tensors.

    template (3 V,), shape_basis (S, 3 V), pose_basis (135, 3 V): flattened. regressor (16, V), weights (V, 16).
    tips (5,): vertices of the fingertips. xp: numpy or torch.
    """

    template: Any
    shape_basis: Any
    pose_basis: Any
    regressor: Any
    weights: Any
    tips: Any
    xp: ModuleType

    def rest(self, betas: Any = None) -> tuple[Any, Any]:
        """Vertices (N, V, 3) and joints (N, 16, 3) at the zero pose, MANO's frame, of betas (N, S' <= S).

        Without betas, the mean shape with N = 1. MANO's own translation t of a mesh puts the wrist at joint 0 + t.
        """
        flat = self.template[None]
        if betas is not None:
            flat = flat + betas @ self.shape_basis[: betas.shape[1]]
        vertices = flat.reshape(flat.shape[0], -1, 3)
        return vertices, self.xp.matmul(self.regressor, vertices)

    def forward(self, rotations: Any, wrist: Any, betas: Any = None) -> tuple[Any, Any]:
        """Vertices (N, V, 3) and key points (N, 21, 3) of joint rotations (N, 16, 3, 3) and wrist positions (N, 3).

        rotations[:, 0] is R_WH, the others are relative to their parents; wrist is in the world, m; so is the
        result. betas: (N, S'), (1, S') for all alike, or None for the mean shape.
        """
        xp, n = self.xp, rotations.shape[0]
        shaped, joints = self.rest(betas)
        feature = (rotations[:, 1:] - self._eye(rotations)).reshape(n, -1)
        posed = shaped + (feature @ self.pose_basis).reshape(n, -1, 3)
        turns, places = [rotations[:, 0]], [wrist]
        for part in range(1, N_PARTS):
            parent = PART_PARENT[part]
            bone = joints[:, part] - joints[:, parent]
            places.append(places[parent] + _apply(xp, turns[parent], bone))
            turns.append(xp.matmul(turns[parent], rotations[:, part]))
        turn, place = xp.stack(turns, 1), xp.stack(places, 1)
        shift = place - _apply(xp, turn, joints)
        blended = xp.matmul(self.weights, turn.reshape(n, N_PARTS, 9)).reshape(n, -1, 3, 3)
        vertices = _apply(xp, blended, posed) + xp.matmul(self.weights, shift)
        fingers = [xp.stack([place[:, 1 + 3 * f + s] for s in range(3)] + [vertices[:, self.tips[f]]], 1)
                   for f in range(5)]
        return vertices, xp.concatenate([place[:, :1], *fingers], 1)

    def _eye(self, like: Any) -> Any:
        return np.eye(3) if self.xp is np else self.xp.eye(3, dtype=like.dtype, device=like.device)


def numpy_skin(model: ManoModel) -> HandSkin:
    """The model for numpy arrays, float64."""
    return _skin(model, np, lambda array: array, list(map(int, model.tip_vertices)))


def torch_skin(model: ManoModel, dtype: torch.dtype | None = None, device: str = "cpu") -> HandSkin:
    """The model for torch tensors (float64 by default). Gradients flow to rotations, wrist and betas."""
    import torch  # Imported late: building a hand does not need it.

    def tensor(array: Any) -> Any:
        return torch.as_tensor(np.ascontiguousarray(array), dtype=dtype or torch.float64, device=device)

    return _skin(model, torch, tensor, list(map(int, model.tip_vertices)))


def euler_rotations(angles: Any) -> Any:
    """(..., 3, 3) R = Rx(a) Ry(b) Rz(c) of intrinsic XYZ angles (..., 3), arrays or tensors."""
    xp = _namespace(angles)
    (ca, cb, cc), (sa, sb, sc) = (tuple(f(angles)[..., i] for i in range(3)) for f in (xp.cos, xp.sin))
    entries = [
        cb * cc, -cb * sc, sb,
        ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb,
        sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb,
    ]  # fmt: skip
    return xp.stack(entries, -1).reshape(*angles.shape, 3)


def axis_angle_rotations(vectors: Any) -> Any:
    """(..., 3, 3) rotations of rotation vectors (..., 3), arrays or tensors; smooth at zero."""
    xp = _namespace(vectors)
    # The tiny number, far below the precision of either, keeps value and gradient finite at zero.
    angle = xp.sqrt((vectors**2).sum(-1) + 1e-30)
    first, second = xp.sin(angle) / angle, 2.0 * (xp.sin(angle / 2.0) / angle) ** 2
    x, y, z = (vectors[..., i] for i in range(3))
    entries = [
        1.0 - second * (y * y + z * z), second * x * y - first * z, second * x * z + first * y,
        second * x * y + first * z, 1.0 - second * (x * x + z * z), second * y * z - first * x,
        second * x * z - first * y, second * y * z + first * x, 1.0 - second * (x * x + y * y),
    ]  # fmt: skip
    return xp.stack(entries, -1).reshape(*vectors.shape, 3)


def _skin(model: ManoModel, xp: ModuleType, convert: Any, tips: list[int]) -> HandSkin:
    order = list(PART_TO_MANO)
    n = len(model.template)
    pose = model.pose_basis.reshape(3 * n, 15, 9)[:, [joint - 1 for joint in order[1:]]].reshape(3 * n, 135)
    return HandSkin(
        template=convert(model.template.reshape(-1)),
        shape_basis=convert(model.shape_basis.reshape(3 * n, -1).T),
        pose_basis=convert(pose.T),
        regressor=convert(model.J_regressor[order]),
        weights=convert(model.weights[:, order]),
        tips=tips,
        xp=xp,
    )


def _apply(xp: ModuleType, R: Any, v: Any) -> Any:
    """R v for (..., 3, 3) and (..., 3)."""
    return xp.matmul(R, v[..., None])[..., 0]


def _namespace(values: Any) -> ModuleType:
    if isinstance(values, np.ndarray):
        return np
    import torch

    return torch
