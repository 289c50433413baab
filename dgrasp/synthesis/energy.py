"""The energy of static grasps and its minimisation, for a batch of hands at once.

Terms: contact, force closure, penetration, self-penetration, table, joint limits and a prior of natural hands. Force
closure is the residual wrench of forces along the contacts' normals, whose shares are optimised with the hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from dgrasp.hand.mano.skinning import axis_angle_rotations
from dgrasp.rl.adam import Adam
from dgrasp.synthesis.torch_hand import ObjectField, TorchHand, tensor
from dgrasp.types import Array

PRESS = 0.0015
"""m. Depth in the object that a pad should reach, as soft flesh does."""
TOLERATED = 0.003
"""m. Penetration up to this depth costs nothing."""
TABLE_CLEARANCE = 0.003
"""m. Wanted distance between hand and table."""
_SELF_TOLERATED = 0.002
_ARM = 0.04
"""m, the lever that makes torques comparable with forces."""
ITERATIONS = 140
"""Steps of the descent; half as many follow once joints have yielded."""
_RATES = {"t": 0.0020, "w": 0.025, "motions": 0.025, "shares": 0.1}
_STEEPEST, _STEEPEST_M = 10.0, 3000.0
"""Largest norms of gradients, per rad and per m."""
WEIGHTS = {"contact": 1.0, "facing": 2.0, "closure": 15.0, "penetration": 0.6, "self": 0.5, "table": 0.6,
           "limits": 1.0, "prior": 0.06, "upright": 4.0}  # fmt: skip
LOWEST_THUMB_SIDE, HIGHEST_POINTING = 0.0, 0.0
"""Smallest z of the axis to the thumb's side, and largest z of the axis from the wrist to the knuckles. At a table, an
arm cannot turn the hand much further. In 95 of 100 recorded labels of the paper they are above -0.14 and below 0."""


@dataclass(frozen=True, eq=False)
class Grasps:
    """B hands around one object, in its frame O; tensors.

    R (B, 3, 3), t (B, 3) m: wrists. motions (B, M) rad. wanted (B, P) bool: the parts that should touch.
    up (B, 3), over (B,): the table; a point x is up @ x + over m above it. yields (B, J) bool: joints that the object's
    pressure has turned beyond their limits, and that the motions do not move. angles (B, J) rad: their angles.
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
        return hand.tied(torch.where(self.yields, self.angles, hand.clipped(hand.pose(self.motions))))

    def take(self, rows: Tensor) -> Grasps:
        """The grasps of these rows."""
        return Grasps(**{name: values[rows] for name, values in vars(self).items()})

    def __len__(self) -> int:
        return len(self.t)


def energies(
    hand: TorchHand, field: ObjectField, grasps: Grasps, shares: Tensor, center: Tensor
) -> dict[str, Tensor]:
    """The unweighted terms of the energy, (B,) each.

    shares (B, P): logits of the contacts' forces. center (3,): the centre of mass in O, m.
    """
    pose = hand.pose(grasps.motions)
    posed = hand.forward(grasps.R, grasps.t, hand.tied(torch.where(grasps.yields, grasps.angles, pose)))
    depth = hand.radii - field.distance(posed.centers)
    point, distance, normal = contact_points(hand, field, hand.pad_points(posed))
    wanted = grasps.wanted.float()
    count = wanted.sum(1)
    gap = (distance + PRESS) / 0.002
    # The thumb alone opposes the fingers, so it weighs as much as all of them.
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

    Zero for a hand without this anatomy (`HandMotions.thumb_side`).
    """
    thumb_side = hand.motions.thumb_side
    if not thumb_side:
        return R.new_zeros(len(R), 2)
    side, pointing = thumb_side * (R[:, :, 2] * up).sum(1), ((R @ hand.pointing) * up).sum(1)
    return torch.stack([torch.relu(LOWEST_THUMB_SIDE - side), torch.relu(pointing - HIGHEST_POINTING)], 1)


def contact_points(hand: TorchHand, field: ObjectField, pads: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """For each part, the pad point nearest to the object (B, P, 3), its distance (B, P) and normal (B, P, 3)."""
    with torch.no_grad():
        distance = field.distance(pads)
        nearest = torch.stack([mine[distance[:, mine].argmin(1)] if len(mine) else mine.new_zeros(len(pads))
                               for mine in hand.members], 1)  # fmt: skip
    point = pads.gather(1, nearest[..., None].expand(-1, -1, 3))
    return point, *field.with_normal(point)


def residual_wrench(
    point: Tensor, normal: Tensor, shares: Tensor, wanted: Tensor, center: Tensor
) -> tuple[Tensor, Tensor]:
    """Net force (B, 3), and net torque over a lever (B, 3), when the wanted parts press along their normals.

    point, normal: (B, P, 3). shares (B, P): logits; the forces add up to 1.
    """
    weight = torch.softmax(shares.masked_fill(~wanted, -torch.inf), 1)
    force = -weight[..., None] * normal
    torque = torch.linalg.cross((point - center) / _ARM, force)
    return force.sum(1), torque.sum(1)


def overlaps(hand: TorchHand, centers: Tensor) -> Tensor:
    """(B, S', S') m by which every second sphere overlaps those of other fingers (`TorchHand.pairs`); else negative."""
    chosen, apart = hand.pairs
    x = centers[:, chosen]
    squared = (x * x).sum(-1)
    gap = (squared[:, :, None] + squared[:, None] - 2.0 * x @ x.transpose(1, 2)).clamp_min(1e-10).sqrt()
    r = hand.radii[chosen]
    return torch.where(apart, r[:, None] + r[None] - gap, -1.0)


def optimise(
    hand: TorchHand, field: ObjectField, grasps: Grasps, center: Array, iterations: int = ITERATIONS,
    stepped: Callable[[], None] = lambda: None,
) -> tuple[Grasps, dict[str, Tensor]]:
    """Minimise all terms together by gradient descent, with joint angles clipped to the limits.

    Returns the grasps found and their terms. stepped: called after each iteration.
    """
    middle = tensor(center)
    w = torch.zeros_like(grasps.t, requires_grad=True)
    t, motions = (value.clone().requires_grad_() for value in (grasps.t, grasps.motions))
    shares = torch.zeros(grasps.wanted.shape, requires_grad=True)
    leaves = {"t": t, "w": w, "motions": motions, "shares": shares}
    groups = [{"params": [leaf], "lr": _RATES[name]} for name, leaf in leaves.items()]
    adam = Adam(groups, betas=(0.9, 0.98))
    slower = torch.optim.lr_scheduler.LambdaLR(adam, lambda k: 0.03 + 0.97 * math.cos(0.5 * math.pi * k / iterations))

    def current() -> Grasps:
        R = grasps.R @ axis_angle_rotations(w)
        return replace(grasps, R=R, t=t, motions=motions)

    for _ in range(iterations):
        adam.zero_grad()
        terms = energies(hand, field, current(), shares, middle)
        total = torch.stack([WEIGHTS[name] * value for name, value in terms.items()]).sum()
        total.backward()
        # A sphere that starts deep inside the object must not throw the hand away.
        for leaf in leaves.values():
            if leaf.grad is not None:
                norm = leaf.grad.norm(dim=1, keepdim=True).clamp_min(1e-9)
                leaf.grad.mul_(((_STEEPEST_M if leaf is t else _STEEPEST) / norm).clamp_max(1.0))
        adam.step()
        slower.step()
        stepped()
    with torch.no_grad():
        found = current()
        found = replace(found, t=t.detach(), motions=motions.detach())
        return found, energies(hand, field, found, shares, middle)


YIELD_DEG = (1.5, 7.0)
"""Smallest and largest angle of a yielding joint beyond its limit."""
_THUMB_YIELDS, _FINGERS_YIELD = 0.75, 0.6
"""Shares of the grasps in which the thumb yields, and in which the fingers do."""
_LEVER = 0.008
"""m per rad. A joint yields only if it moves the touching pads away from the object by at least this."""
_FARTHEST = math.radians(45.0)
"""rad. A joint this far or farther from its limit does not yield."""


def let_yield(hand: TorchHand, field: ObjectField, grasps: Grasps, rng: np.random.Generator) -> Grasps:
    """The grasps; in most of them, pressure turns a joint of the thumb or of each touching finger beyond its limits.

    The joint is that of the finger which is nearest to the limit towards which the finger's pads leave the object. Soft
    hands yield like this, and recorded grasps exceed the limits too. A controller whose targets stop at the limits
    closes such a joint and so grasps; a controller whose targets are the current angles presses on nothing.
    """
    pose = grasps.pose(hand).requires_grad_()
    # A joint that follows another has no lever of its own.
    posed = hand.forward(grasps.R, grasps.t, hand.tied(pose))
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
