"""The energy of a static grasp and its descent, for a batch of hands at once.

Contact, force closure, penetration, self-penetration, table, joint limits and a prior of natural hands. Force closure
is the residual wrench of forces along the contacts' normals, whose shares are optimised with the hand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from dgrasp.hand.mano.skinning import axis_angle_rotations
from dgrasp.synthesis.torch_hand import ObjectField, TorchHand, tensor
from dgrasp.types import Array

PRESS = 0.0015
"""m that a pad is wanted to be in the object, as soft flesh is."""
TOLERATED = 0.003
"""m of penetration that costs nothing."""
TABLE_CLEARANCE = 0.003
"""m between hand and table."""
_SELF_TOLERATED = 0.002
_ARM = 0.04
"""m, the lever that makes torques comparable with forces."""
ITERATIONS = 140
"""Steps of the descent; half as many follow once joints have yielded."""
_RATES = {"t": 0.0020, "w": 0.025, "motions": 0.025, "shares": 0.1}
_STEEPEST, _STEEPEST_M = 10.0, 3000.0
"""Longest gradients, per rad and per m."""
WEIGHTS = {"contact": 1.0, "facing": 2.0, "closure": 15.0, "penetration": 0.6, "self": 0.5, "table": 0.6,
           "limits": 1.0, "prior": 0.06, "upright": 4.0}  # fmt: skip
LOWEST_THUMB_SIDE, HIGHEST_POINTING = 0.0, 0.0
"""Least z of the axis to the thumb's side, and greatest z of the axis from the wrist to the knuckles: nobody's arm
turns the hand much further at a table. The paper's recorded labels have above -0.14 and below 0 in 95 of 100."""


@dataclass(frozen=True, eq=False)
class Grasps:
    """B hands about one object, in its frame O; tensors.

    R (B, 3, 3), t (B, 3) m: wrists. motions (B, M) rad. wanted (B, P) bool: the parts that are to touch.
    up (B, 3), over (B,): the table; a point x is up @ x + over m above it. yields (B, J) bool, angles (B, J) rad:
    joints that the object's pressure has turned to an angle beyond their limits, and which the motions do not move.
    """

    R: Tensor
    t: Tensor
    motions: Tensor
    wanted: Tensor
    up: Tensor
    over: Tensor
    yields: Tensor
    angles: Tensor

    def pose(self, hand: TorchHand) -> Tensor:
        """(B, J) joint angles, within the limits except for the joints that yield."""
        return torch.where(self.yields, self.angles, hand.clipped(hand.pose(self.motions)))

    def take(self, rows: Tensor) -> Grasps:
        """These rows."""
        return Grasps(**{name: values[rows] for name, values in vars(self).items()})

    def __len__(self) -> int:
        return len(self.t)


def energies(
    hand: TorchHand, field: ObjectField, grasps: Grasps, shares: Tensor, center: Tensor
) -> dict[str, Tensor]:
    """The terms (B,), unweighted. shares (B, P): logits of the contacts' forces. center (3,): of mass, in O."""
    pose = hand.pose(grasps.motions)
    posed = hand.forward(grasps.R, grasps.t, torch.where(grasps.yields, grasps.angles, pose))
    depth = hand.radii - field.distance(posed.centers)
    point, distance, normal = contact_points(hand, field, hand.pad_points(posed))
    wanted = grasps.wanted.float()
    count = wanted.sum(1)
    gap = (distance + PRESS) / 0.002
    # The thumb is alone on its side.
    weight = wanted.clone()
    weight[:, hand.thumb_tip] *= count - 1.0
    contact = (weight * (torch.sqrt(1.0 + gap * gap) - 1.0)).sum(1) / count
    palmar = (posed.R @ hand.palmar[..., None])[..., 0]
    facing = (wanted * torch.relu(0.7 + (palmar * normal).sum(-1)) ** 2).sum(1)
    force, torque = residual_wrench(point, normal, shares, grasps.wanted, center)
    height = (posed.centers @ grasps.up[..., None])[..., 0] + grasps.over[:, None] - hand.radii
    limits = ~grasps.yields * (torch.relu(hand.limits[0] - pose) + torch.relu(pose - hand.limits[1]))
    white = (grasps.motions - tensor(hand.motions.mean)) @ tensor(hand.motions.whiten.T)
    return {
        "contact": contact,
        "facing": facing / count,
        "closure": (force**2).sum(1) + (torque**2).sum(1),
        "penetration": (torch.relu(depth - TOLERATED) ** 2).sum(1) / 0.002**2,
        "self": (torch.relu(overlaps(hand, posed.centers) - _SELF_TOLERATED) ** 2).sum((1, 2)) / 0.002**2,
        "table": (torch.relu(TABLE_CLEARANCE - height) ** 2).sum(1) / 0.003**2,
        "limits": (limits**2).sum(1) / 0.05**2,
        "prior": 0.5 * (white**2).sum(1),
        "upright": (unnatural(hand, grasps.R, grasps.up) ** 2).sum(1),
    }


def unnatural(hand: TorchHand, R: Tensor, up: Tensor) -> Tensor:
    """(B, 2): how far wrists R (B, 3, 3) are turned beyond `LOWEST_THUMB_SIDE` and `HIGHEST_POINTING`. up: (B, 3).

    Zero for a hand that has no anatomy (`HandMotions.thumb_side`).
    """
    thumb_side = hand.motions.thumb_side
    if not thumb_side:
        return R.new_zeros(len(R), 2)
    side, pointing = thumb_side * (R[:, :, 2] * up).sum(1), ((R @ hand.pointing) * up).sum(1)
    return torch.stack([torch.relu(LOWEST_THUMB_SIDE - side), torch.relu(pointing - HIGHEST_POINTING)], 1)


def contact_points(hand: TorchHand, field: ObjectField, pads: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of each part the pad point nearest to the object: (B, P, 3), its distance (B, P) and normal (B, P, 3)."""
    with torch.no_grad():
        distance = field.distance(pads)
        nearest = torch.stack([mine[distance[:, mine].argmin(1)] if len(mine) else mine.new_zeros(len(pads))
                               for mine in hand.members], 1)  # fmt: skip
    point = pads.gather(1, nearest[..., None].expand(-1, -1, 3))
    return point, *field.with_normal(point)


def residual_wrench(
    point: Tensor, normal: Tensor, shares: Tensor, wanted: Tensor, center: Tensor
) -> tuple[Tensor, Tensor]:
    """Force (B, 3) and torque over a lever (B, 3) that are left when the wanted parts press along their normals.

    point, normal: (B, P, 3). shares (B, P): logits; the forces add up to 1.
    """
    weight = torch.softmax(shares.masked_fill(~wanted, -torch.inf), 1)
    force = -weight[..., None] * normal
    torque = torch.linalg.cross((point - center) / _ARM, force)
    return force.sum(1), torque.sum(1)


def overlaps(hand: TorchHand, centers: Tensor) -> Tensor:
    """(B, S, S) m by which spheres of different fingers overlap, of every other sphere; else negative."""
    chosen, apart = hand.pairs
    x = centers[:, chosen]
    squared = (x * x).sum(-1)
    gap = (squared[:, :, None] + squared[:, None] - 2.0 * x @ x.transpose(1, 2)).clamp_min(1e-10).sqrt()
    r = hand.radii[chosen]
    return torch.where(apart, r[:, None] + r[None] - gap, -1.0)


def optimise(
    hand: TorchHand, field: ObjectField, grasps: Grasps, center: Array, iterations: int = ITERATIONS
) -> tuple[Grasps, dict[str, Tensor]]:
    """The grasps after a descent of all energies together, joint angles clipped to the limits, and their terms."""
    middle = tensor(center)
    w = torch.zeros_like(grasps.t, requires_grad=True)
    t, motions = (value.clone().requires_grad_() for value in (grasps.t, grasps.motions))
    shares = torch.zeros(grasps.wanted.shape, requires_grad=True)
    leaves = {"t": t, "w": w, "motions": motions, "shares": shares}
    groups = [{"params": [leaf], "lr": _RATES[name]} for name, leaf in leaves.items()]
    adam = torch.optim.Adam(groups, betas=(0.9, 0.98))
    slower = torch.optim.lr_scheduler.LambdaLR(adam, lambda k: 0.03 + 0.97 * math.cos(0.5 * math.pi * k / iterations))

    def current() -> Grasps:
        R = grasps.R @ axis_angle_rotations(w)
        return replace(grasps, R=R, t=t, motions=motions)

    for _ in range(iterations):
        adam.zero_grad()
        terms = energies(hand, field, current(), shares, middle)
        total = torch.stack([WEIGHTS[name] * value for name, value in terms.items()]).sum()
        total.backward()
        # A sphere that starts deep inside must not throw its hand away.
        for leaf in leaves.values():
            if leaf.grad is not None:
                norm = leaf.grad.norm(dim=1, keepdim=True).clamp_min(1e-9)
                leaf.grad.mul_(((_STEEPEST_M if leaf is t else _STEEPEST) / norm).clamp_max(1.0))
        adam.step()
        slower.step()
    with torch.no_grad():
        found = current()
        found = replace(found, t=t.detach(), motions=motions.detach())
        return found, energies(hand, field, found, shares, middle)


YIELD_DEG = (1.5, 7.0)
"""How far a joint that yields is beyond its limit."""
_THUMB_YIELDS, _FINGERS_YIELD = 0.75, 0.6
"""Shares of the grasps."""
_LEVER = 0.008
"""m by which a joint that yields moves its pads away from the object, per rad."""
_FARTHEST = math.radians(45.0)
"""A joint this far within its limit does not reach it."""


def let_yield(hand: TorchHand, field: ObjectField, grasps: Grasps, rng: np.random.Generator) -> Grasps:
    """The grasps, in most of them a joint of the thumb or of each touching finger turned beyond its limits by pressure.

    Of a finger's joint angles it is the one nearest to that limit towards which its pads leave the object. Soft hands
    yield like that, and recorded grasps leave the limits too. A controller whose targets stop at the limits closes such
    a joint, and so grasps; one whose target is where the hand is presses on nothing.
    """
    pose = grasps.pose(hand).requires_grad_()
    posed = hand.forward(grasps.R, grasps.t, pose)
    _, distance, _ = contact_points(hand, field, hand.pad_points(posed))
    lever = torch.autograd.grad((distance * grasps.wanted).sum(), pose)[0]
    with torch.no_grad():
        opening = lever.sign()
        limit = torch.where(opening > 0, hand.limits[1], hand.limits[0])
        room = ((limit - pose) * opening).masked_fill(lever.abs() < _LEVER, torch.inf)
        n = len(grasps)
        draws = torch.as_tensor(rng.uniform(size=(n, 2)) < (_FINGERS_YIELD, _THUMB_YIELDS))
        yields = torch.zeros(room.shape, dtype=torch.bool)
        for index, finger in enumerate(hand.layout.fingers):
            joints = torch.as_tensor(finger.joints)
            nearest, joint = room[:, joints].min(1)
            chosen = draws[:, 1 if index == hand.thumb else 0] & (nearest < _FARTHEST)
            yields[torch.arange(n), joints[joint]] = chosen
        beyond = tensor(np.radians(rng.uniform(*YIELD_DEG, (n, 1))))
        return replace(grasps, yields=yields, angles=torch.where(yields, limit + opening * beyond, grasps.angles))
