"""The free grasp labels: `python -m dgrasp.labels.make_free --out DIR` writes free_train.npz and free_test.npz.

For each of the 20 objects hands are proposed around it at rest on the table (`dgrasp.labels.free_grasps`) and
closed; a physics check tells which grasps hold the object when the hand just stays in the label's pose. A set has
both: some that hold, and more that a policy must first learn to hold. The same seed gives the same bytes on one
machine.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgrasp.config import Config
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.errors import ConfigError, DGraspError
from dgrasp.hand.free_hand import HAND_NAME, URDF_PATH
from dgrasp.hand.model import HandModel, load_hand
from dgrasp.labels.distance import CONTACT_DISTANCE, HandSpheres, hand_bottom, part_distances
from dgrasp.labels.free_grasps import (
    START_CLEARANCE,
    TABLE_CLEARANCE,
    Grasps,
    close,
    grip_quality,
    hand_pose,
    propose,
)
from dgrasp.labels.native import write_native
from dgrasp.objects.catalogue import CATALOGUE
from dgrasp.objects.free import free_object
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.types import Array, GraspLabel, StartPose
from raisim_like.rotations import matrix_from_euler

LICENCE = "MIT"
SOURCE = "free"

MAX_OVERLAP = 0.008
"""m. No hand part is deeper in the object than this."""
DRAWN_BACK = (0.10, 0.15)
"""m between the wrist at the start and at the grasp."""
START_TURN = 0.12
"""rad, half-width of the start's wrist angles about those of the grasp."""
HOLD_STEPS = 80
"""Control steps of the physics check; what is still held then rarely falls later."""
MAX_HOLDING = 0.5
"""Largest share of an object's labels that hold by themselves."""

_DRAWS, _MAX_DRAWS = 2500, 40000
_CLOSED_PER_LABEL, _CANDIDATES_PER_LABEL = 24, 2


@dataclass(frozen=True)
class Checked:
    """Labels of one object that passed all conditions, and whether each held in the physics check."""

    labels: list[GraspLabel]
    holds: Array


def make_labels(
    name: str, count: int, seed: int, hand: HandModel, config: Config, spheres: HandSpheres | None = None
) -> Checked:
    """`count` labels of the free object `name`, deterministic from `seed`.

    Raises `ConfigError` where too few grasps are found.
    """
    spheres = HandSpheres.of_hand(hand) if spheres is None else spheres
    model = free_object(name, config.physics.masses, config.physics.official_compat)
    rng = np.random.default_rng([seed, *(int(digits) for digits in (name[:3],))])
    labels: list[GraspLabel] = []
    holds: list[Array] = []
    drawn = 0
    while sum(len(part) for part in holds) < count * _CANDIDATES_PER_LABEL and drawn < _MAX_DRAWS:
        grasps = propose(hand, spheres, model, rng, _DRAWS)
        drawn += _DRAWS
        close(hand, spheres, model, grasps)
        quality = grip_quality(hand, spheres, model, grasps)
        print(len(grasps), np.isfinite(quality).sum())
        break
    return Checked(labels, np.concatenate(holds))
