"""A hand and an object with gradients: batched kinematics of the hand's spheres and distance to the object, in torch.

Everything is in the object's frame O, float32 on the CPU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from dgrasp.geometry.distance_grid import DistanceGrid
from dgrasp.hand.layout import N_WRIST
from dgrasp.hand.mano.skinning import axis_angle_rotations, euler_rotations
from dgrasp.hand.model import HandModel
from dgrasp.hand.motions import HandMotions, hand_motions
from dgrasp.hand.spheres import HandSpheres
from dgrasp.types import Array


def tensor(values: Array) -> Tensor:
    """A float32 tensor of these values."""
    return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float32)


class ObjectField:
    """The signed distance to an object, by linear interpolation in its grid, and the surface's normals."""

    def __init__(self, grid: DistanceGrid) -> None:
        slopes: Array = np.stack([np.gradient(grid.values, grid.pitch, axis=axis) for axis in range(3)])
        slopes /= np.maximum(np.linalg.norm(slopes, axis=0), 1e-6)
        # grid_sample expects x as the last axis.
        layers = np.concatenate([grid.values[None], slopes]).transpose(0, 3, 2, 1)
        self._layers = tensor(layers)[None]
        self._low, self._size = tensor(grid.low), tensor(grid.high - grid.low)

    def distance(self, points: Tensor) -> Tensor:
        """(...) m, negative inside, of points (..., 3) in O; beyond the grid, the distance to the grid is added."""
        return self._look_up(points, slice(0, 1))[0]

    def with_normal(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """The same distance, and the surface's outward unit normals (..., 3)."""
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
    """B hands in O. R (B, P, 3, 3), t (B, P, 3) m: parts. centers (B, S, 3) m: spheres."""

    R: Tensor
    t: Tensor
    centers: Tensor


class TorchHand:
    """A hand's spheres, motions and limits as tensors: S spheres, P parts, J finger joints, M motions.

    radii (S,), parts (S,) and local (S, 3): the spheres, as in `HandSpheres`. pads (S, 3): from each centre to the
    sphere's surface on the pad's side, in the part's frame. thumb: the finger that opposes the `others`; thumb_tip: its
    last part. knuckles (3,): the middle of the others' roots in the wrist's frame, m; pointing (3,): the direction to
    it. pairs: see `_pairs`.
    """

    def __init__(self, hand: HandModel) -> None:
        self.model, self.layout = hand, hand.layout
        self.spheres = HandSpheres.of_hand(hand)
        self.motions: HandMotions = hand_motions(hand)
        self.parts = torch.as_tensor(self.spheres.parts)
        self.radii, self.local = tensor(self.spheres.radii), tensor(self.spheres.centers)
        self.palmar = tensor(self.motions.palmar)
        self.pads = self.radii[:, None] * self.palmar[self.parts]
        self.to_pose = tensor(self.motions.to_pose)
        self.limits = tensor(hand.limits[N_WRIST:].T)
        self._ties = tensor(hand.ties.matrix.T), tensor(hand.ties.offset)
        self._offsets, self._tips = tensor(hand.offsets), tensor(hand.tips)
        self._levels, self._order = self._floors()
        self.members = [torch.nonzero(self.parts == part)[:, 0] for part in range(self.layout.n_parts)]
        self.pairs = self._pairs()
        fingers = self.layout.fingers
        self.thumb = self.motions.thumb
        self.thumb_tip = fingers[self.thumb].parts[-1]
        self.others = [finger for index, finger in enumerate(fingers) if index != self.thumb]
        roots = [finger.parts[0] for finger in self.others] or [self.thumb_tip]
        self.knuckles: Array = hand.offsets[roots].mean(axis=0)
        self.pointing = tensor(self.knuckles / max(float(np.linalg.norm(self.knuckles)), 1e-9))

    def _floors(self) -> tuple[list[tuple[list[int], list[int]]], list[int]]:
        """Parts grouped into floors by their number of joints from the palm.

        Returns each floor's parts with the indices of their parents in the floor below, and the index of each part in
        all floors, palm first, laid end to end.
        """
        parents = self.model.chain.parents.tolist()
        floors, below = [], [0]
        while True:
            parts = [part for part, parent in enumerate(parents) if parent in below]
            if not parts:
                break
            floors.append((parts, [below.index(parents[part]) for part in parts]))
            below = parts
        laid = [0, *(part for parts, _ in floors for part in parts)]
        return floors, [laid.index(part) for part in range(len(parents))]

    def _pairs(self) -> tuple[Tensor, Tensor]:
        """Indices (S',) of every second sphere, and (S', S') bool: the pairs that should not overlap, each once.

        The spheres of a pair are on two fingers, or on the palm and on a finger beyond its base.
        """
        chosen = torch.cat([mine[::2] for mine in self.members])
        part = self.parts[chosen]
        finger = torch.as_tensor(self.layout.finger_of_part)[part] + 1  # 0 is the palm
        bases = torch.zeros(self.layout.n_parts, dtype=torch.bool)
        bases[[finger.parts[0] for finger in self.layout.fingers]] = True
        outer = ~bases[part]
        with_palm = (part[:, None] == 0) | (part[None] == 0)
        # Neighbouring knuckles touch in every hand.
        both_bases = ~outer[:, None] & ~outer[None]
        apart = (finger[:, None] != finger[None]) & (~with_palm | (outer[:, None] & outer[None])) & ~both_bases
        return chosen, apart & (part[:, None] < part[None])

    def pose(self, motions: Tensor) -> Tensor:
        """(B, J) joint angles of motions (B, M), rad."""
        return self.tied(motions @ self.to_pose)

    def tied(self, pose: Tensor) -> Tensor:
        """(B, J) angles with those of joints that follow others replaced by what they must be."""
        matrix, offset = self._ties
        return pose @ matrix + offset if len(self.model.ties.followers) else pose

    def clipped(self, pose: Tensor) -> Tensor:
        """(B, J) angles clipped to the joint limits."""
        return self.tied(torch.minimum(torch.maximum(pose, self.limits[0]), self.limits[1]))

    def forward(self, R: Tensor, t: Tensor, pose: Tensor) -> PosedHand:
        """The hands with wrists R (B, 3, 3), t (B, 3) and joint angles (B, J)."""
        turn = self._part_turns(pose)
        at, now = t[:, None], R[:, None]
        places, turns = [at], [now]
        for parts, parents in self._levels:
            at, now = at[:, parents], now[:, parents]
            at = at + (now @ self._offsets[parts, :, None])[..., 0]
            now = now @ turn[:, [part - 1 for part in parts]]
            places.append(at)
            turns.append(now)
        place, turned = torch.cat(places, 1)[:, self._order], torch.cat(turns, 1)[:, self._order]
        centers = (turned[:, self.parts] @ self.local[..., None])[..., 0] + place[:, self.parts]
        return PosedHand(turned, place, centers)

    def _part_turns(self, pose: Tensor) -> Tensor:
        """(B, P - 1, 3, 3): the rotation of each part except the palm relative to its parent."""
        chain = self.model.chain
        if chain.all_euler:
            return euler_rotations(pose.reshape(-1, self.layout.n_parts - 1, 3))
        turns = []
        for part in range(1, self.layout.n_parts):
            turn = torch.eye(3).expand(len(pose), 3, 3)
            for joint in chain.joints_of[part].tolist():
                about = axis_angle_rotations(pose[:, joint, None] * tensor(chain.axes[joint]))
                turn = turn @ tensor(chain.joint_frames[joint]) @ about
            turns.append(turn)
        return torch.stack(turns, 1)

    def pad_points(self, hand: PosedHand) -> Tensor:
        """(B, S, 3): the spheres' points on the pad's side."""
        return hand.centers + (hand.R[:, self.parts] @ self.pads[..., None])[..., 0]

    def tips(self, hand: PosedHand) -> Tensor:
        """(B, number of tips, 3): the fingertips, in the order of `layout.tips`."""
        owners = self.model.chain.keypoint_parts[list(self.layout.tips)].tolist()
        return hand.t[:, owners] + (hand.R[:, owners] @ self._tips[..., None])[..., 0]

    def per_part(self, distances: Tensor) -> Tensor:
        """(B, P): the smallest of the values (B, S) of each part's spheres; infinite for a part without spheres."""
        out = distances.new_full((len(distances), self.layout.n_parts), torch.inf)
        return out.scatter_reduce(1, self.parts.expand(len(distances), -1), distances, "amin")
