"""A hand and an object for gradients: batched kinematics of the hand's spheres and the object's distance, in torch.

Everything is in the object's frame O, float32 on the CPU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from dgrasp.geometry.distance_grid import DistanceGrid
from dgrasp.hand.mano.model import Side
from dgrasp.hand.mano.skeleton import N_PARTS
from dgrasp.hand.mano.skinning import euler_rotations
from dgrasp.hand.model import HandModel
from dgrasp.hand.motions import HandMotions, hand_motions
from dgrasp.hand.spheres import HandSpheres
from dgrasp.types import Array

_FIRST = [1, 4, 7, 10, 13]
_ORDER = [0, *(1 + 5 * segment + finger for finger in range(5) for segment in range(3))]
"""From palm and rings of five equal segments to the order of `skeleton.PARTS`."""


def tensor(values: Array) -> Tensor:
    """As float32."""
    return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float32)


class ObjectField:
    """The signed distance to an object, by linear interpolation in its grid, and the surface's normals."""

    def __init__(self, grid: DistanceGrid) -> None:
        slopes: Array = np.stack([np.gradient(grid.values, grid.pitch, axis=axis) for axis in range(3)])
        slopes /= np.maximum(np.linalg.norm(slopes, axis=0), 1e-6)
        # grid_sample has x last.
        layers = np.concatenate([grid.values[None], slopes]).transpose(0, 3, 2, 1)
        self._layers = tensor(layers)[None]
        self._low, self._size = tensor(grid.low), tensor(grid.high - grid.low)

    def distance(self, points: Tensor) -> Tensor:
        """(...) m, negative inside, of points (..., 3) in O; beyond the grid the way to it is added."""
        return self._look_up(points, slice(0, 1))[0]

    def with_normal(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """The same, and the unit normals (..., 3) of the surface, outwards."""
        found = self._look_up(points, slice(0, 4))
        normal = found[1:].movedim(0, -1)
        return found[0], normal / normal.norm(dim=-1, keepdim=True).clamp_min(1e-6)

    def _look_up(self, points: Tensor, layers: slice) -> Tensor:
        share = (points - self._low) / self._size
        within = share.clamp(0.0, 1.0)
        at = (2.0 * within - 1.0).reshape(1, -1, 1, 1, 3)
        found = grid_sample(self._layers[:, layers], at, align_corners=True, padding_mode="border")
        found = found.reshape(found.shape[1], *points.shape[:-1])
        beyond = ((((share - within) * self._size) ** 2).sum(-1) + 1e-20).sqrt()
        return torch.cat([found[:1] + beyond, found[1:]])


@dataclass(frozen=True, eq=False)
class PosedHand:
    """B hands in O. R (B, 16, 3, 3), t (B, 16, 3): parts. centers (B, P, 3): spheres."""

    R: Tensor
    t: Tensor
    centers: Tensor


class TorchHand:
    """A hand's spheres, motions and limits as tensors.

    radii (P,), parts (P,) and local (P, 3): the spheres, as in `HandSpheres`. pads (P, 3): from each centre to the
    sphere's surface on the pad's side, in the part's frame. knuckles (3,): their middle in the wrist's frame, m;
    pointing (3,): the direction to it. pairs: see `_pairs`.
    """

    def __init__(self, hand: HandModel, side: Side) -> None:
        self.model = hand
        self.spheres = HandSpheres.of_hand(hand)
        self.motions: HandMotions = hand_motions(hand, side)
        self.parts = torch.as_tensor(self.spheres.parts)
        self.radii, self.local = tensor(self.spheres.radii), tensor(self.spheres.centers)
        self.palmar = tensor(self.motions.palmar)
        self.pads = self.radii[:, None] * self.palmar[self.parts]
        self.to_pose = tensor(self.motions.to_pose)
        self.limits = tensor(hand.limits[6:].T)
        self._offsets, self._tips = tensor(hand.offsets), tensor(hand.tips)
        self.members = [torch.nonzero(self.parts == part)[:, 0] for part in range(N_PARTS)]
        self.pairs = self._pairs()
        self.knuckles: Array = hand.offsets[_FIRST[:4]].mean(axis=0)
        self.pointing = tensor(self.knuckles / np.linalg.norm(self.knuckles))

    def _pairs(self) -> tuple[Tensor, Tensor]:
        """Every other sphere (S,), and (S, S) bool: those that should not overlap, each pair once.

        They are of two fingers, or of the palm and a finger beyond its base.
        """
        chosen = torch.cat([mine[::2] for mine in self.members])
        part = self.parts[chosen]
        finger = torch.div(part + 2, 3, rounding_mode="floor")  # 0 the palm, 1 to 5 the fingers
        outer = (part == 0) | ((part - 1) % 3 > 0)
        with_palm = (part[:, None] == 0) | (part[None] == 0)
        # Neighbouring knuckles touch in every hand.
        bases = ~outer[:, None] & ~outer[None]
        apart = (finger[:, None] != finger[None]) & (~with_palm | (outer[:, None] & outer[None])) & ~bases
        return chosen, apart & (part[:, None] < part[None])

    def pose(self, motions: Tensor) -> Tensor:
        """(B, 45) joint angles of motions (B, 21), rad."""
        return motions @ self.to_pose

    def clipped(self, pose: Tensor) -> Tensor:
        """(B, 45) within the joint limits."""
        return torch.minimum(torch.maximum(pose, self.limits[0]), self.limits[1])

    def forward(self, R: Tensor, t: Tensor, pose: Tensor) -> PosedHand:
        """The hands of wrists R (B, 3, 3), t (B, 3) and joint angles (B, 45)."""
        turn = euler_rotations(pose.reshape(-1, N_PARTS - 1, 3))
        at, now = t[:, None].expand(-1, 5, -1), R[:, None].expand(-1, 5, -1, -1)
        places, turns = [t[:, None]], [R[:, None]]
        for segment in range(3):
            index = [first + segment for first in _FIRST]
            at = at + (now @ self._offsets[index, :, None])[..., 0]
            now = now @ turn[:, [i - 1 for i in index]]
            places.append(at)
            turns.append(now)
        place, turned = torch.cat(places, 1)[:, _ORDER], torch.cat(turns, 1)[:, _ORDER]
        centers = (turned[:, self.parts] @ self.local[..., None])[..., 0] + place[:, self.parts]
        return PosedHand(turned, place, centers)

    def pad_points(self, hand: PosedHand) -> Tensor:
        """(B, P, 3): the spheres' points on the pad's side."""
        return hand.centers + (hand.R[:, self.parts] @ self.pads[..., None])[..., 0]

    def tips(self, hand: PosedHand) -> Tensor:
        """(B, 5, 3): the fingertips."""
        distal = [first + 2 for first in _FIRST]
        return hand.t[:, distal] + (hand.R[:, distal] @ self._tips[..., None])[..., 0]

    def per_part(self, distances: Tensor) -> Tensor:
        """(B, 16): the smallest of values (B, P) of each part's spheres; infinite for a part without any."""
        out = distances.new_full((len(distances), N_PARTS), torch.inf)
        return out.scatter_reduce(1, self.parts.expand(len(distances), -1), distances, "amin")
