"""Target poses T_g of motion synthesis.

The authors' set, a set of our own like it, one far from it, and the assignment of targets to labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.joblib import read_joblib_arrays
from dgrasp.types import Array, GraspLabel
from raisim_like.rotations import matrix_from_euler, matrix_from_rotation_vector, transform

EASY_FILE = "motion_eval_dict_easy.pkl"
"""The authors' targets, in the folder of their labels."""
SET_SIZE = 100
"""Targets of a test set (paper, section 4.5)."""
OOD_XY, OOD_Z = 0.4, (0.15, 0.5)
"""m. Displacements of the set "ood", which leave out those of the authors' set: at most 0.2 sideways and 0.3 up."""
OOD_ANGLE = (0.95, 1.5)
"""rad, about any axis; the authors' rotations reach 0.93."""
_EASY_XY, _EASY_Z, _EASY_ANGLE = 0.2, 0.3, 0.5
"""The authors' set: m sideways, m up, and rad of each Euler angle."""
_LARGEST = (5.0, 2.0 * np.pi)
"""m and rad. A file with larger numbers is taken to be in another unit."""


@dataclass(frozen=True)
class TargetSet:
    """n targets, each of P poses, one per control step; a target that stands still has P = 1.

    T: (n, P, 4, 4). relative: T moves the object away from its label's pose: the translation is added, the rotation is
    about the object's origin, both along the world's axes. Otherwise T is the object's pose in the world.
    """

    name: str
    T: Array
    relative: bool

    def place(self, which: Sequence[int] | Array, labels: Sequence[GraspLabel]) -> Array:
        """The paths (N, P, 4, 4) of T_WG for N labels; label i goes to target which[i]."""
        T = np.array(self.T[np.asarray(which, dtype=int)])
        if self.relative:
            T_WO = np.array([label.T_WO for label in labels])
            T[..., :3, :3] = np.matmul(T[..., :3, :3], T_WO[:, None, :3, :3])
            T[..., :3, 3] += T_WO[:, None, :3, 3]
        return T


def easy_targets(path: Path) -> TargetSet:
    """Read the authors' file: displacements `target_pos` (n, 3) m and `ang_noise` (n, 3) rad, intrinsic XYZ Euler.

    Their code adds the first to the label's object position and turns the label's object by the second, about the
    world's axes. Raises `DataError` for anything else.
    """
    content = read_joblib_arrays(path)
    arrays: list[Any] = [content.get(key) if isinstance(content, dict) else None for key in ("target_pos", "ang_noise")]
    for array, largest, unit in zip(arrays, _LARGEST, ("metres", "radians"), strict=True):
        fits = isinstance(array, np.ndarray) and array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind == "f"
        if not fits or len(array) == 0 or not (np.isfinite(array).all() and np.abs(array).max() <= largest):
            raise DataError(f"{path}: not the authors' motion targets; expected target_pos (n, 3) in metres and "
                            f"ang_noise (n, 3) in radians, finite, and these {unit} within {largest:.3g}")
    position, angles = arrays
    if len(position) != len(angles):
        raise DataError(f"{path}: {len(position)} positions and {len(angles)} rotations; expected equal numbers")
    return TargetSet("easy", transform(matrix_from_euler(angles), position)[:, None], relative=True)


def near_targets(seed: int) -> TargetSet:
    """`SET_SIZE` random targets drawn like the authors' set, but turned both ways about each axis."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5,)))
    T = np.array([_draw_near(rng) for _ in range(SET_SIZE)])
    return TargetSet("near", T[:, None], relative=True)


def _draw_near(rng: np.random.Generator) -> Array:
    """(4, 4): a displacement within the box and the angles of the authors' set."""
    position = rng.uniform([-_EASY_XY, -_EASY_XY, 0.0], [_EASY_XY, _EASY_XY, _EASY_Z])
    T: Array = transform(matrix_from_euler(rng.uniform(-_EASY_ANGLE, _EASY_ANGLE, 3)), position)
    return T


def ood_targets(seed: int) -> TargetSet:
    """`SET_SIZE` random targets outside the range of the authors' set: farther away, and turned farther.

    Positions are uniform in a box from which the box of the authors' set is cut out. Rotations have a uniform axis and
    a uniform angle in `OOD_ANGLE`.
    """
    # The spawn key keeps this stream apart from others with the same seed.
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(4,)))
    positions: list[Array] = []
    while len(positions) < SET_SIZE:
        position = rng.uniform([-OOD_XY, -OOD_XY, OOD_Z[0]], [OOD_XY, OOD_XY, OOD_Z[1]])
        if (np.abs(position[:2]) > _EASY_XY).any() or position[2] > _EASY_Z:
            positions.append(position)
    axes = rng.normal(size=(SET_SIZE, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    R = matrix_from_rotation_vector(axes * rng.uniform(*OOD_ANGLE, (SET_SIZE, 1)))
    return TargetSet("ood", transform(R, np.array(positions))[:, None], relative=True)


OWN_SETS = {"near": near_targets, "ood": ood_targets}
"""Sets that are drawn from a seed, by their names in `--motion`."""


def training_target(label: GraspLabel, rng: np.random.Generator) -> Array:
    """(4, 4): a target T_WG for training, drawn like those of `near_targets`."""
    placed: Array = TargetSet("training", _draw_near(rng)[None, None], relative=True).place([0], [label])[0, 0]
    return placed


def draw_targets(n_targets: int, n_labels: int, per_label: int | None, rng: np.random.Generator) -> Array:
    """(rounds, n_labels): which target each label goes to in each round.

    per_label: the number of rounds; together they use all targets as equally often as possible. None makes one round
    per target, in which all labels go to it.
    """
    if per_label is None:
        return np.repeat(np.arange(n_targets)[:, None], n_labels, axis=1)
    needed = per_label * n_labels
    shuffled = [rng.permutation(n_targets) for _ in range(-(-needed // n_targets))]
    return np.concatenate(shuffled)[:needed].reshape(per_label, n_labels)
