"""Synthesis of static grasps for any hand and object.

Grasps are proposed, optimised, sifted, given a start, and tried in physics. All random numbers come from the generator
that is passed in: on one machine, the same seed gives the same labels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dgrasp.config.experiment import Config
from dgrasp.config.sections import PhysicsConfig
from dgrasp.errors import ConfigError
from dgrasp.geometry.distance_grid import distance_grid
from dgrasp.geometry.equilibrium import holds_weight
from dgrasp.geometry.intersection import body
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.hand.layout import N_WRIST
from dgrasp.hand.model import HandModel
from dgrasp.hand.spheres import CONTACT_DISTANCE
from dgrasp.objects.model import ObjectModel
from dgrasp.synthesis.energy import (
    ITERATIONS,
    Grasps,
    contact_points,
    let_yield,
    optimise,
    overlaps,
    residual_wrench,
    unnatural,
)
from dgrasp.synthesis.path import free_starts, orthonormal
from dgrasp.synthesis.progress import Report, SearchShare, search_and_trial
from dgrasp.synthesis.start import LIFT, Setting, propose, rest_poses
from dgrasp.synthesis.torch_hand import ObjectField, TorchHand, tensor
from dgrasp.synthesis.trial import gt_pd_holds
from dgrasp.types import Array, GraspLabel, StartPose
from raisim_like.rotations import transform

SOURCE = "synthesised"
MAX_DEPTH = 0.006
"""m. Every sphere of the hand is less deep in the object."""
MAX_SELF_OVERLAP = 0.005
"""m. Two fingers overlap by less than this."""
MAX_TURNED = 0.15
"""A wrist is turned beyond its natural range by less than this (`energy.unnatural`)."""
TOUCHING = 0.001
"""m. A pad this close to the object touches it."""
IN_CONTACT = 0.003
"""m. A pad this close to the object can press on it."""
RESERVE = 0.75
"""Share of the simulated friction with which the contacts must be able to hold the object's weight."""
FRICTION = PhysicsConfig().friction
HOLDING_SHARE = 0.3
"""Share of an object's labels that hold by themselves under gt_pd, if that many are found; 0.3 as in DexYCB."""
BATCH, _ROUNDS = 96, 6
"""Hands per round, and rounds that look for more grasps than were asked for; later ones stop at the number asked."""
_CHECKED_PER_LABEL = 3.0
_BARREN, _BARREN_ROUNDS = 0.02, 3
"""The search stops after this many barren rounds in a row: rounds in which less than this share of hands is sound."""


@dataclass(frozen=True, eq=False)
class Synthesised:
    """Labels of one object, and their figures (N,).

    held: whether the label holds under gt_pd. quality: by geometry alone, higher is better. depth: m, of the deepest
    sphere. touching: number of parts whose pad touches. found_held: the share of all tried grasps that held.
    """

    labels: list[GraspLabel]
    held: Array
    quality: Array
    depth: Array
    touching: Array
    found_held: float


@dataclass(frozen=True, eq=False)
class _Found:
    """Sound grasps in O, with the object's poses at rest and at the grasp (`rest`, `T_WO`) and the grasps' figures."""

    grasps: Grasps
    rest: Array
    T_WO: Array
    quality: Array
    depth: Array
    touching: Array
    apart: Array
    """(N, P) m between parts and object."""

    def take(self, rows: Array) -> _Found:
        values = {name: value[rows] for name, value in vars(self).items() if name != "grasps"}
        return _Found(grasps=self.grasps.take(torch.as_tensor(rows)), **values)

    def __len__(self) -> int:
        return len(self.rest)


class Synthesiser:
    """Synthesises grasps of one hand."""

    def __init__(self, hand: HandModel) -> None:
        self.hand = hand
        self.torch_hand = TorchHand(hand)

    def make(
        self, model: ObjectModel, count: int, rng: np.random.Generator, config: Config, batch: int = BATCH,
        iterations: int = ITERATIONS, report: Report = lambda share: None,
    ) -> Synthesised:
        """Make `count` diverse labels of an object.

        Some hold under gt_pd in `config.engine`; the others are left for a policy to learn. Raises `ConfigError` if too
        few sound grasps are found. report: called with the share that is done.
        """
        wanted = round(_CHECKED_PER_LABEL * count)
        search, trial = search_and_trial(config.engine)
        share = SearchShare(report, search, wanted, batch, _ROUNDS, iterations + _second(iterations))
        parts, starts = self._search(make_setting(model), count, wanted, rng, batch, iterations, share)
        order = _farthest_first(self._features(parts), parts.quality, min(wanted, len(starts)))
        labels = self._labels(model.name, parts.take(order), [starts[i] for i in order])
        held = gt_pd_holds(labels, self.hand, model, config, lambda done: report(search + trial * done))
        # Shuffled, because splits, limits and demos take the first labels of an object as a sample.
        chosen = rng.permutation(order_of_both(held, count))
        rows = order[chosen]
        return Synthesised([labels[i] for i in chosen], held[chosen], parts.quality[rows], parts.depth[rows],
                           parts.touching[rows], float(held.mean()))

    def _search(
        self, setting: Setting, count: int, wanted: int, rng: np.random.Generator, batch: int, iterations: int,
        share: SearchShare,
    ) -> tuple[_Found, list[StartPose]]:
        """The sound grasps of as many rounds as needed: `wanted` in the first few rounds, or else at least `count`."""
        rounds: list[tuple[_Found, list[StartPose]]] = []
        found, barren = 0, 0
        while found < wanted and (len(rounds) < _ROUNDS or (found < count and barren < _BARREN_ROUNDS)):
            rounds.append(self._round(setting, rng, batch, iterations, share.step))
            new = len(rounds[-1][1])
            found, barren = found + new, barren + 1 if new < _BARREN * batch else 0
            share.round_done(found)
        if found < count:
            raise ConfigError(
                f"{setting.model.name}: found {found} sound grasps of {count}, next to none in the last {barren} "
                f"rounds of {batch} hands; ask for fewer, or change the seed"
            )
        return _join([part for part, _ in rounds]), [one for _, some in rounds for one in some]

    def _round(
        self, setting: Setting, rng: np.random.Generator, batch: int, iterations: int, stepped: Callable[[], None]
    ) -> tuple[_Found, list[StartPose]]:
        """The sound grasps of one batch that have a free start."""
        rest = rest_poses(setting, rng, batch)
        T_WO = rest.copy()
        T_WO[:, 2, 3] += rng.uniform(0.0, LIFT, batch)
        proposed = propose(self.torch_hand, setting, T_WO, rng)
        center = setting.model.center_of_mass_O
        hand, field = self.torch_hand, setting.field
        grasps, _ = optimise(hand, field, proposed, center, iterations, stepped)
        yielding = let_yield(hand, field, grasps, rng)
        grasps, _ = optimise(hand, field, yielding, center, _second(iterations), stepped)
        found = self._sound(setting, grasps, rest, T_WO)
        starts, free = free_starts(hand, setting, found.grasps, found.rest, found.T_WO, rng)
        return found.take(np.flatnonzero(free)), [starts[i] for i in np.flatnonzero(free)]

    @torch.no_grad()
    def _sound(self, setting: Setting, grasps: Grasps, rest: Array, T_WO: Array) -> _Found:
        """The grasps that neither penetrate too much nor miss, and whose contacts can hold the object, with figures."""
        hand, field = self.torch_hand, setting.field
        posed = hand.forward(grasps.R, grasps.t, grasps.pose(hand))
        distance = field.distance(posed.centers) - hand.radii
        height = (posed.centers @ grasps.up[..., None])[..., 0] + grasps.over[:, None] - hand.radii
        point, gap, normal = contact_points(hand, field, hand.pad_points(posed))
        touching = gap < TOUCHING
        force, torque = _best_wrench(point, normal, touching, tensor(setting.model.center_of_mass_O), hand.thumb_tip)
        depth = -distance.amin(1)
        others, thumb_finger = hand.others, hand.layout.fingers[hand.thumb]
        fingers = sum(touching[:, list(finger.parts)].any(1).int() for finger in others)
        thumb = touching[:, list(thumb_finger.parts)].any(1)
        turned = unnatural(hand, grasps.R, grasps.up).amax(1)
        sound = (
            (depth < MAX_DEPTH) & (height.amin(1) > 0.0) & thumb & (fingers >= min(2, len(others)))
            & (turned < MAX_TURNED) & (overlaps(hand, posed.centers).amax((1, 2)) < MAX_SELF_OVERLAP)
        )  # fmt: skip
        quality = -(force.norm(dim=1) + 0.5 * torque.norm(dim=1)) + 0.05 * touching.sum(1)
        # A controller pulls a yielding joint back, and so grasps.
        own = torch.zeros(hand.layout.n_joints, dtype=torch.bool)
        own[list(thumb_finger.joints)] = True
        quality += 0.2 * grasps.yields[:, ~own].any(1) + 0.2 * grasps.yields[:, own].any(1)
        rows = np.flatnonzero(sound.numpy())
        rows = rows[self._holding(setting, grasps, (point, gap, normal), rows)]
        figures = (quality, depth, touching.sum(1), hand.per_part(distance))
        return _Found(grasps, rest, T_WO, *(value.numpy() for value in figures)).take(rows)

    def _holding(
        self, setting: Setting, grasps: Grasps, contacts: tuple[Tensor, Tensor, Tensor], rows: Array
    ) -> Array:
        """(len(rows),) bool: whether the contacts of these grasps can hold the object's weight."""
        point, gap, normal = (value.numpy().astype(float) for value in contacts)
        center, up = setting.model.center_of_mass_O, grasps.up.numpy().astype(float)
        # In the middle of a thin wall the normal is unknown.
        near = (gap < IN_CONTACT) & (np.linalg.norm(normal, axis=2) > 0.5)
        return np.array(
            [holds_weight(point[i, near[i]], normal[i, near[i]], center, up[i], RESERVE * FRICTION) for i in rows], bool
        )

    @torch.no_grad()
    def _features(self, found: _Found) -> Array:
        """(N, F) m: joints and tips in O, by which grasps are compared."""
        g, hand = found.grasps, self.torch_hand
        posed = hand.forward(g.R, g.t, g.pose(hand))
        return np.asarray(torch.cat([posed.t, hand.tips(posed)], 1).reshape(len(found), -1).numpy())

    def _labels(self, name: str, found: _Found, starts: list[StartPose]) -> list[GraspLabel]:
        g = found.grasps
        # The limits are float64: rounding must not move angles out of them.
        pose = g.pose(self.torch_hand).numpy().astype(float)
        pose = np.where(g.yields.numpy(), pose, np.clip(pose, *self.hand.limits[N_WRIST:].T))
        pose = self.hand.ties.coordinates(pose)
        T_WH = found.T_WO @ transform(orthonormal(g.R.numpy().astype(float)), g.t.numpy().astype(float))
        joints = self.hand.keypoints_at(T_WH, pose)
        return [
            GraspLabel(name, pose[i], T_WH[i], found.T_WO[i], joints[i], found.apart[i] < CONTACT_DISTANCE, starts[i],
                       self.hand.id, SOURCE, i)
            for i in range(len(found))
        ]  # fmt: skip


def _second(iterations: int) -> int:
    """Steps of the second descent, once joints have yielded."""
    return max(1, iterations // 2)


def make_setting(model: ObjectModel) -> Setting:
    """The setting of an object: the union of its collision shapes and the distance field of that."""
    united = body([shape_mesh(shape) for shape in model.shapes])
    return Setting(model, united, ObjectField(distance_grid(united)))


def order_of_both(held: Array, count: int) -> Array:
    """(count,) rows: a share of `HOLDING_SHARE` that hold and the rest that do not, each kind in its order.

    If there are too few of one kind, there are more of the other.
    """
    good, bad = np.flatnonzero(held), np.flatnonzero(~held)
    n_good = max(min(len(good), round(HOLDING_SHARE * count)), count - len(bad))
    return np.sort(np.concatenate([good[:n_good], bad[: count - n_good]]))


def _best_wrench(
    point: Tensor, normal: Tensor, touching: Tensor, center: Tensor, thumb_tip: int
) -> tuple[Tensor, Tensor]:
    """The residual wrench of the touching parts if the thumb presses as hard as all others together."""
    shares = torch.zeros(touching.shape)
    shares[:, thumb_tip] = torch.log((touching.sum(1) - touching[:, thumb_tip].float()).clamp_min(1.0))
    safe = touching.clone()
    safe[:, thumb_tip] = True
    return residual_wrench(point, normal, shares, safe, center)


def _farthest_first(features: Array, quality: Array, count: int) -> Array:
    """(count,) rows, the best first, each of the others as far as possible from those before it."""
    order = [int(quality.argmax())]
    apart = np.linalg.norm(features - features[order[0]], axis=1)
    while len(order) < count:
        order.append(int(apart.argmax()))
        apart = np.minimum(apart, np.linalg.norm(features - features[order[-1]], axis=1))
        apart[order] = -1.0
    return np.array(order)


def _join(parts: list[_Found]) -> _Found:
    names = [name for name in vars(parts[0]) if name != "grasps"]
    grasps = Grasps(**{k: torch.cat([vars(p.grasps)[k] for p in parts]) for k in vars(parts[0].grasps)})
    return _Found(grasps=grasps, **{k: np.concatenate([vars(p)[k] for p in parts]) for k in names})
