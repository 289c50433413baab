"""The free grasp labels: `python -m dgrasp.labels.make_free --out DIR` writes free_train.npz and free_test.npz.

For each of the 20 free objects, hands are proposed around it at rest on the table and closed
(`dgrasp.labels.free_grasps`); a physics check tells which of them hold the object when the hand just stays in the
label's pose. Each object gets both: some that do, up to `HOLDING_SHARE`, and more for which that is left to be
learned. How well the label's pose holds is therefore chosen here, not a result: the grasps that hold are almost
all ones whose joints leave their limits (`free_grasps.BENT_SHARE`). The same seed gives the same bytes on one
machine.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dgrasp.config import Config
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.errors import ConfigError, DGraspError
from dgrasp.hand.free_hand import HAND_NAME, URDF_PATH
from dgrasp.hand.model import HandModel, load_hand
from dgrasp.hand.skeleton import N_DOF
from dgrasp.labels.distance import CONTACT_DISTANCE, HandSpheres, hand_bottom, part_distances
from dgrasp.labels.free_grasps import Grasps, angles_of, close, finger_angles, grip_quality, join, propose
from dgrasp.labels.native import write_native
from dgrasp.objects.catalogue import CATALOGUE, catalogue_object
from dgrasp.objects.free import free_object
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.types import Array, GraspLabel, StartPose
from raisim_like.rotations import matrix_from_euler

LICENCE = "MIT"
SOURCE = "free"

MAX_OVERLAP = 0.008
"""m. No part of the hand is deeper in the object than this."""
DRAWN_BACK = (0.10, 0.15)
"""m between the wrist at the start and at the grasp."""
START_TURN = 0.12
"""rad, half-width of the wrist angles at the start about those of the grasp."""
START_CLEARANCE = 0.03
"""m from the hand at the start to object and table: more than the noise of a training reset."""
PATH_OVERLAP = 0.003
"""m that the open hand may graze the object on its straight way."""
HOLD_STEPS = 60
"""Control steps of the physics check; what is held until then rarely falls later."""
HOLDING_SHARE = 0.4
"""Share of an object's labels that hold by themselves, where that many are found."""

_DRAWS, _MAX_ROUNDS = 2500, 16
_SOUND_PER_LABEL, _CHECKED_PER_LABEL = 8, 2


@dataclass(frozen=True)
class _Maker:
    """What all steps of one object's labels need."""

    hand: HandModel
    spheres: HandSpheres
    model: ObjectModel
    rng: np.random.Generator


def make_labels(name: str, count: int, seed: int, hand: HandModel, config: Config) -> tuple[list[GraspLabel], Array]:
    """`count` labels of the free object `name`, deterministic from `seed`, and (count,) which of them held.

    Raises `ConfigError` where too few grasps are found.
    """
    model = free_object(name, config.physics.masses, config.physics.official_compat)
    rng = np.random.default_rng([seed, catalogue_object(name).id])
    maker = _Maker(hand, HandSpheres.of_hand(hand), model, rng)
    grasps = _ranked(maker, count)
    labels = _labels(maker, grasps, _CHECKED_PER_LABEL * count)
    if len(labels) < count:
        raise ConfigError(f"{name}: found {len(labels)} grasps of {count}; ask for fewer, or change the seed")
    wanted, holds = round(HOLDING_SHARE * count), np.zeros(0, bool)
    # Checked in parts, until there are enough of both kinds.
    while len(holds) < len(labels) and (holds.sum() < wanted or (~holds).sum() < count - wanted):
        part = labels[len(holds) : len(holds) + (count + 1) // 2]
        holds = np.concatenate([holds, check_holds(part, hand, model, config)])
    held, fell = rng.permutation(np.flatnonzero(holds)), rng.permutation(np.flatnonzero(~holds))
    n_held = max(min(len(held), wanted), count - len(fell))
    chosen = rng.permutation(np.concatenate([held[:n_held], fell[: count - n_held]]))
    return [labels[i] for i in chosen], holds[chosen]


def _ranked(maker: _Maker, count: int) -> Grasps:
    """Sound grasps, the promising and random ones by turns."""
    found: list[Grasps] = []
    qualities: list[Array] = []
    for _ in range(_MAX_ROUNDS):
        grasps = propose(maker.hand, maker.spheres, maker.model, maker.rng, _DRAWS)
        grasps = grasps.take(np.arange(len(grasps)) < 2 * _SOUND_PER_LABEL * count)
        close(maker.hand, maker.spheres, maker.model, grasps)
        quality = grip_quality(maker.hand, maker.spheres, maker.model, grasps)
        pose = angles_of(maker.hand, grasps)
        apart = part_distances(
            maker.hand, maker.spheres, maker.model.shapes, grasps.T_WH, pose, grasps.T_WO
        ).min(axis=1)
        good = np.isfinite(quality) & (apart > -MAX_OVERLAP)
        found.append(grasps.take(good))
        qualities.append(quality[good])
        if sum(len(part) for part in found) >= _SOUND_PER_LABEL * count:
            break
    best = list(np.argsort(-np.concatenate(qualities), kind="stable"))
    mixed = list(maker.rng.permutation(len(best)))
    order = dict.fromkeys(int(i) for pair in zip(best, mixed, strict=True) for i in pair)
    return join(found).take(np.array(list(order), dtype=int))


def _labels(maker: _Maker, grasps: Grasps, limit: int) -> list[GraspLabel]:
    """Labels of the first `limit` grasps that have a free start and way."""
    hand = maker.hand
    grasps = grasps.take(np.arange(len(grasps)) < 3 * limit)
    pose = angles_of(hand, grasps)
    open_pose = finger_angles(hand, grasps.open_flexion, grasps.side, *np.zeros((2, len(grasps))))
    starts, free = _starts(maker, grasps, open_pose)
    apart = part_distances(hand, maker.spheres, maker.model.shapes, grasps.T_WH, pose, grasps.T_WO)
    gc = np.concatenate([np.zeros((len(grasps), N_DOF - 45)), pose], axis=1)
    _, joints_W = hand.forward(gc, grasps.T_WH[:, :3, :3], grasps.T_WH[:, :3, 3])
    return [
        GraspLabel(
            maker.model.name, pose[i], grasps.T_WH[i], grasps.T_WO[i], joints_W[i], apart[i] < CONTACT_DISTANCE,
            StartPose(starts[i], grasps.T_WO_rest[i], open_pose[i]), HAND_NAME, SOURCE, 0,
        )
        for i in np.flatnonzero(free)[:limit]
    ]  # fmt: skip


def _starts(maker: _Maker, grasps: Grasps, pose: Array) -> tuple[Array, Array]:
    """(N, 4, 4) wrists drawn back from the grasps, and (N,) whether start and way are free."""
    n = len(grasps)
    best, done = grasps.T_WH.copy(), np.zeros(n, bool)
    for _ in range(6):
        back = -grasps.approach_W + maker.rng.normal(0.0, 0.25, (n, 3))
        back[:, 2] += maker.rng.uniform(0.2, 1.2, n)
        back *= maker.rng.uniform(*DRAWN_BACK, (n, 1)) / np.linalg.norm(back, axis=1, keepdims=True)
        start = grasps.T_WH.copy()
        start[:, :3, 3] += back
        start[:, :3, :3] = start[:, :3, :3] @ matrix_from_euler(maker.rng.uniform(-START_TURN, START_TURN, (n, 3)))
        free = _clearance(maker, grasps, start, pose) > START_CLEARANCE
        for share in (0.75, 0.5, 0.25, 0.0):
            way = grasps.T_WH.copy()
            way[:, :3, 3] += share * back
            free &= _clearance(maker, grasps, way, pose) > -PATH_OVERLAP
        best[free & ~done] = start[free & ~done]
        done |= free
    return best, done


def _clearance(maker: _Maker, grasps: Grasps, T_WH: Array, pose: Array) -> Array:
    """(N,) m between the hand and the object at rest, or the table."""
    apart = part_distances(maker.hand, maker.spheres, maker.model.shapes, T_WH, pose, grasps.T_WO_rest).min(axis=1)
    above: Array = hand_bottom(maker.hand, maker.spheres, T_WH, pose) - TABLE_TOP
    return np.minimum(apart, above)


def check_holds(labels: list[GraspLabel], hand: HandModel, model: ObjectModel, config: Config) -> Array:
    """(N,) bool: the object stays in the hand that keeps the label's pose, for `HOLD_STEPS` without a table."""
    env = GraspEnv(labels, hand, {model.name: model}, config)
    env.reset(mode="label")
    still = np.zeros((len(labels), N_DOF))
    for _ in range(HOLD_STEPS):
        env.step(still)
        # What has fallen needs no more physics.
        env.alive &= ~env.s.table_contact.astype(bool)
    holds = env.alive.copy()
    env.close()
    return holds


def split(labels: list[list[GraspLabel]], n_test: int, seed: int) -> tuple[list[GraspLabel], list[GraspLabel]]:
    """Train and test labels of equally long lists, one list per object, each split in the same proportion."""
    share, extra = divmod(n_test, len(labels))
    more = set(np.random.default_rng([seed, 0]).permutation(len(labels))[:extra].tolist())
    train: list[GraspLabel] = []
    test: list[GraspLabel] = []
    for k, mine in enumerate(labels):
        cut = share + (k in more)
        test += [replace(label, index=i) for i, label in enumerate(mine[:cut])]
        train += [replace(label, index=i) for i, label in enumerate(mine[cut:])]
    return train, test


def main(arguments: list[str]) -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m dgrasp.labels.make_free", description="Make the free labels.")
    parser.add_argument("--out", type=Path, required=True, help="folder for free_train.npz and free_test.npz")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--train", type=int, default=376, help="number of train labels, over all objects")
    parser.add_argument("--test", type=int, default=124)
    options = parser.parse_args(arguments)
    total = options.train + options.test
    if options.seed < 0 or min(options.train, options.test) < len(CATALOGUE) or total % len(CATALOGUE):
        raise ConfigError(f"--seed {options.seed} --train {options.train} --test {options.test}: expected a seed of at "
                          f"least 0, and numbers of at least {len(CATALOGUE)} whose sum is a multiple of that: as "
                          "many labels for each object")
    hand, config = load_hand(URDF_PATH, HAND_NAME), Config()
    made, held = [], {}
    begin = time.monotonic()
    for entry in CATALOGUE:
        labels, holds = make_labels(entry.name, total // len(CATALOGUE), options.seed, hand, config)
        made.append(labels)
        held[entry.name] = int(holds.sum())
        print(f"{entry.name}: {len(labels)} labels, {held[entry.name]} hold ({time.monotonic() - begin:.0f} s)",
              flush=True)
    for name, part in zip(("train", "test"), split(made, options.test, options.seed), strict=True):
        provenance = {"made_by": "dgrasp.labels.make_free", "seed": options.seed, "split": name,
                      "hold_in_train_and_test": held}
        path = options.out / f"free_{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_native(path, part, provenance, LICENCE)
        print(f"{path}: {len(part)} labels, {path.stat().st_size} bytes")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except DGraspError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
