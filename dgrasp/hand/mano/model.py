"""A hand in MANO's layout: mesh, blend shapes, joints and skinning weights; and its mirror image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.errors import DataError
from dgrasp.hand.layout import Side
from dgrasp.hand.mano.skeleton import FINGERS, MANO_FINGERS, N_PARTS
from dgrasp.types import Array

EXTENT = (0.08, 0.5)
"""m. Range of the largest extent of a hand; outside it, a model is taken to be in another unit."""

MANO_PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
"""Parents of MANO's 16 joints: the wrist, then three per finger, in the order `skeleton.MANO_FINGERS`."""

PART_TO_MANO = (0, *(1 + 3 * MANO_FINGERS.index(finger) + segment for finger in FINGERS for segment in range(3)))
"""For each of `skeleton.PARTS` the index of its joint in MANO's order."""

MIRROR = np.array([-1.0, 1.0, 1.0])
"""MANO's left hand is its right hand after x -> -x; so is a mirrored hand here, in its wrist frame."""
MIRROR_ANGLES = np.array([1.0, -1.0, -1.0])
"""The same for rotations: the factors of rotation vectors and of Euler angles about x, y, z."""

MANO_TIPS: dict[Side, tuple[int, ...]] = {"right": (317, 444, 556, 673, 745), "left": (317, 445, 556, 673, 745)}
"""Vertices of MANO's own mesh that DexYCB and others use as fingertips, order of `skeleton.FINGERS`."""


@dataclass(frozen=True, eq=False)
class ManoModel:
    """A hand model of V vertices in MANO's layout and order of joints; m, MANO's frame.

    template (V, 3): vertices of the mean shape at the zero pose. shape_basis (V, 3, S): displacement per unit of a
    shape parameter (beta). pose_basis (V, 3, 135): displacement per entry of (R - 1) of joints 1 to 15, row by row.
    J_regressor (16, V): joints from vertices. weights (V, 16): skinning weights. faces (F, 3). kintree (2, 16):
    parents (-1 for the wrist) and ids of the joints. hands_mean (45,), hands_components (45, 45): mean and
    principal components (rows) of the finger joints' rotation vectors, rad. side: a right or a left hand.
    tip_vertices (5,): vertices of the fingertips, order of `skeleton.FINGERS`.

    In MANO's frame the fingers of a right hand point along -x, those of a left hand along +x, the palm faces -y
    and the thumb is on the +z side; all joint frames are parallel to it at the zero pose.
    """

    template: Array
    shape_basis: Array
    pose_basis: Array
    J_regressor: Array
    weights: Array
    faces: Array
    kintree: Array
    hands_mean: Array
    hands_components: Array
    side: Side
    tip_vertices: Array

    def part_weights(self) -> Array:
        """(V, 16) skinning weights in the order of `skeleton.PARTS`."""
        return self.weights[:, PART_TO_MANO]

    def own_betas(self, betas: Array) -> Array:
        """Betas (N, S'), without zeros beyond the model's S. Raises `DataError` where those are not zero."""
        betas = np.asarray(betas, dtype=float)
        n = self.shape_basis.shape[2]
        if betas.ndim != 2 or (betas[:, n:] != 0.0).any():
            raise DataError(f"betas of shape {betas.shape}; expected (hands, at most {n}), because the MANO file has "
                            f"{n} of them; give the file with which the hands were fitted")
        return betas[:, :n]

    def shaped(self, betas: Array) -> tuple[Array, Array]:
        """Vertices (V, 3) and joints (16, 3), order of `skeleton.PARTS`, of a shape (S' <= S,) at the zero pose.

        Raises `DataError` for more betas than the model has, or values that no hand has.
        """
        betas = np.asarray(betas, dtype=float)
        n = self.shape_basis.shape[2]
        if betas.ndim != 1 or len(betas) > n:
            raise DataError(f"betas of shape {betas.shape}; expected at most {n} numbers")
        if not (np.abs(betas) <= 20.0).all():
            raise DataError(f"betas {betas.tolist()}; expected finite numbers of a few units (mean 0, deviation 1)")
        vertices = self.template + self.shape_basis[..., : len(betas)] @ betas
        extent = float(np.ptp(vertices, axis=0).max())
        if not EXTENT[0] <= extent <= EXTENT[1]:
            raise DataError(f"betas {betas.tolist()} give a hand {extent:g} m long; expected {EXTENT[0]:g} to "
                            f"{EXTENT[1]:g} m")
        return vertices, (self.J_regressor @ vertices)[list(PART_TO_MANO)]


def mirror_mano(model: ManoModel) -> ManoModel:
    """The other hand: the mirror image at x = 0. The same betas and mirrored poses give mirrored meshes."""
    # M R M has the entry (r, c) of R times the signs of r and c.
    entries = np.tile(np.outer(MIRROR, MIRROR).reshape(9), N_PARTS - 1)
    angles = np.tile(MIRROR_ANGLES, N_PARTS - 1)
    return ManoModel(
        template=model.template * MIRROR,
        shape_basis=model.shape_basis * MIRROR[:, None],
        pose_basis=model.pose_basis * MIRROR[:, None] * entries,
        J_regressor=model.J_regressor,
        weights=model.weights,
        faces=model.faces[:, ::-1],
        kintree=model.kintree,
        hands_mean=model.hands_mean * angles,
        hands_components=model.hands_components * angles,
        side="left" if model.side == "right" else "right",
        tip_vertices=model.tip_vertices,
    )


def finger_side(joints: Array) -> Side:
    """The side of the hand with these joints (16, 3), MANO's order and frame. Raises `DataError` for another frame."""
    fingers = joints[4] - joints[0]
    length = float(np.linalg.norm(fingers))
    if length < 1e-3 or abs(fingers[0]) < 0.8 * length or joints[13, 2] <= joints[0, 2]:
        raise DataError("the middle finger does not lie along x or the thumb is not on the side of +z; expected MANO's "
                        "frame (fingers along -x for a right hand, +x for a left one); turn the model")
    return "right" if fingers[0] < 0 else "left"


def tip_vertices(template: Array, joints: Array, weights: Array, side: Side) -> Array:
    """(5,) fingertip vertices: those that DexYCB uses for MANO's own mesh, else the farthest one of each distal part.

    joints (16, 3) and weights (V, 16) in MANO's order.
    """
    owner = weights.argmax(axis=1)
    distal = [PART_TO_MANO[3 + 3 * finger] for finger in range(len(FINGERS))]
    known = np.array(MANO_TIPS[side])
    if len(template) == 778 and (owner[known] == distal).all():
        return known
    tips = []
    for joint in distal:
        mine = np.flatnonzero(owner == joint)
        if not mine.size:
            raise DataError(f"no vertex moves mostly with joint {joint}; expected vertices for all 16 joints")
        tips.append(mine[np.linalg.norm(template[mine] - joints[joint], axis=1).argmax()])
    return np.array(tips)
