"""The free hand's skinned model: `python -m dgrasp.hand.free.make_skin [FILE]` writes it, always the same.

Joints and tips are those of `dgrasp.hand.free.anatomy`, the surface is that of `dgrasp.hand.free.rings`. Skinning
weights fade over a few millimetres about each joint, along the digit that a vertex belongs to; only the thumb's base
moves the palm's skin over a wider range. Everything is computed here, in under three seconds.

Shape parameters (`SHAPES`): one unit is one standard deviation of that measure among British adults of one sex
(Pheasant, "Bodyspace", 2nd ed., 1996), each taken alone.
"""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import numpy as np

from dgrasp.files import licences
from dgrasp.files.atomic import write_atomic
from dgrasp.hand.free.anatomy import RADII, anatomical_axes, finger_direction, hand_parts
from dgrasp.hand.free.rings import RingMesh, digit, ring_mesh
from dgrasp.hand.free.skin import FORMAT, SCHEMA, skin_path
from dgrasp.hand.mano.model import MANO_PARENTS, PART_TO_MANO
from dgrasp.hand.mano.skeleton import FINGERS, N_PARTS, PART_PARENT
from dgrasp.types import Array

SHAPES = (
    ("size of the whole hand", 0.052), ("length of the four fingers", 0.060), ("girth of all digits", 0.050),
    ("breadth of the palm", 0.055), ("thickness of the palm", 0.065), ("length of the thumb", 0.080),
)  # fmt: skip
"""Shape parameters in their order, and the share by which one unit changes the measure."""

RELAXED_DEG = ((20.0, 35.0, 15.0), (25.0, 38.0, 15.0), (28.0, 38.0, 15.0), (30.0, 35.0, 15.0), (5.0, 12.0, 15.0))
"""Flexion per digit and joint in the mean pose: a hand at rest. Our own choice."""

FADES = ((0.0125, 0.0095, 0.0080), (0.0, 0.0130, 0.0110))
"""m. Half the length over which weights fade about each joint, for an index finger and for the thumb."""
_THUMB_PALM = (-0.002, 0.004, -0.074)
"""m. Skin of the palm with z below the first, or x above the second or below the third, stays when the thumb moves."""
_DIFFUSIONS = 12


def skin_arrays() -> dict[str, Array]:
    """Compute the file's arrays, rounded to nine decimals so that platforms agree."""
    mesh = ring_mesh()
    vertices = np.round(mesh.vertices, 9)
    joints = rest_joints()
    moved = moved_shares(mesh, vertices, joints)
    # A part's weight is the share that moves with its joint but not with the next one.
    weights = np.concatenate([np.ones((len(vertices), 1)), moved[:, 1:]], axis=1)
    for part in range(1, N_PARTS):
        weights[:, PART_PARENT[part]] -= moved[:, part]
    order = np.argsort(PART_TO_MANO)
    poses = pose_basis(vertices, joints, moved).reshape(len(vertices), 3, N_PARTS - 1, 9)
    fingers = order[1:] - 1
    mean, components = _poses()
    return {
        "v_template": vertices,
        "f": mesh.faces.astype(np.int32),
        "shapedirs": np.round(shape_basis(vertices, joints, weights), 9),
        "posedirs": np.round(poses[:, :, fingers], 9).reshape(len(vertices), 3, 135),
        "J_regressor": regressor(vertices, joints, moved)[order],
        "weights": np.round(weights[:, order], 9),
        "kintree_table": np.array([MANO_PARENTS, range(N_PARTS)], dtype=np.int32),
        "hands_mean": mean[fingers].reshape(45),
        "hands_components": components.reshape(45, 15, 3)[:, fingers].reshape(45, 45),
    }


def rest_joints() -> Array:
    """(16, 3) m: the free hand's joints at the zero pose, order of `skeleton.PARTS`, wrist at the origin."""
    joints = np.zeros((N_PARTS, 3))
    for index, part in enumerate(hand_parts()):
        if index:
            joints[index] = joints[PART_PARENT[index]] + part.offset
    return joints


def moved_shares(mesh: RingMesh, vertices: Array, joints: Array) -> Array:
    """(V, 16): the share of each vertex that moves with a part or with parts beyond it; 1 for the palm."""
    shares = np.ones((len(vertices), N_PARTS))
    for index, finger in enumerate(FINGERS):
        own, thumb = digit(finger), finger == "thumb"
        along = (vertices - own.origin) @ own.along
        scale = 1.0 if thumb else RADII[finger][1] / RADII["index"][1]
        for bone in range(3):
            fade = 2.0 * scale * FADES[thumb][bone]
            part = 1 + 3 * index + bone
            if fade:
                shares[:, part] = _smooth((along - own.at(bone)) / fade + 0.5) * mesh.digits[:, index]
    base = 1 + 3 * FINGERS.index("thumb")
    shares[:, base] = np.maximum(_thumb_base(mesh, vertices), shares[:, base + 1])
    return shares


def _thumb_base(mesh: RingMesh, vertices: Array) -> Array:
    """(V,): share that moves with the thumb's metacarpal: 1 on the metacarpal's head, diffused evenly around it."""
    own, mine = digit("thumb"), mesh.digits[:, FINGERS.index("thumb")] > 0
    bone = own.lengths[0]
    along = (vertices - own.origin) @ own.along / bone
    foot = own.origin + np.clip(along, 0.45, 1.2)[:, None] * bone * own.along
    away = np.linalg.norm(vertices - foot, axis=1)
    share = _smooth(1.9 - away / 0.0145) * _smooth(along + 0.25)
    share = np.where(mine, np.maximum(share, _smooth((along + 0.1) / 0.9)), share)
    z, low, high = _THUMB_PALM
    still = ~mine & ((vertices[:, 2] < z) | (vertices[:, 0] > low) | (vertices[:, 0] < high))
    whole = mine & (along > 0.93)
    share[still], share[whole] = 0.0, 1.0
    faces = mesh.faces
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    degree = np.bincount(edges.ravel(), minlength=len(vertices))
    for _ in range(_DIFFUSIONS):
        total = np.zeros(len(vertices))
        np.add.at(total, edges[:, 0], share[edges[:, 1]])
        np.add.at(total, edges[:, 1], share[edges[:, 0]])
        share = np.where(still | whole, share, (share + total / degree) / 2.0)
    return np.where(share < 0.01, 0.0, share)


def _smooth(x: Array) -> Array:
    """0 below 0, 1 above 1, and a smooth step between."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))


def regressor(vertices: Array, joints: Array, moved: Array) -> Array:
    """(16, V): shares of vertices that give each joint from the skin that bends there, and the wrist from the opening.

    The shares sum to 1, give the joint, and are as nearly equal as possible. Vertices whose share would be negative are
    left out.
    """
    found = np.zeros((N_PARTS, len(vertices)))
    for part in range(N_PARTS):
        near = np.abs(moved[:, part] - 0.5) < 0.49 if part else vertices[:, 0] > -0.012
        while (found[part] < 0.0).any() or not found[part].any():
            chosen = np.flatnonzero(near)
            equal = np.full(len(chosen), 1.0 / len(chosen))
            rows = np.vstack([np.ones(len(chosen)), (vertices[chosen] - joints[part]).T])
            lack = np.array([1.0, 0.0, 0.0, 0.0]) - rows @ equal
            # A single ring lies in a plane: rcond drops the direction normal to it, which cannot be solved.
            found[part] = 0.0
            found[part, chosen] = equal + np.linalg.lstsq(rows, lack, rcond=1e-6)[0]
            near &= found[part] > 0.0
    return found


def shape_basis(vertices: Array, joints: Array, weights: Array) -> Array:
    """(V, 3, S): displacement per unit of `SHAPES`; weights (V, 16) in the order of `skeleton.PARTS`.

    Each part is stretched about its joint and carries the parts beyond it along.
    """
    basis = np.zeros((len(vertices), 3, len(SHAPES)))
    bones = [np.outer(d, d) for d in (finger_direction(f) for f in FINGERS)]
    for index, (_, unit) in enumerate(SHAPES):
        stretch = np.zeros((N_PARTS, 3, 3))
        for part in range(N_PARTS):
            bone = bones[(part - 1) // 3]
            thumb = part > 12
            if part == 0:
                stretch[part] = (np.eye(3), 0.0, 0.0, np.diag([0.0, 0, 1]), np.diag([0.0, 1, 0]), 0.0)[index]
            else:
                stretch[part] = (np.eye(3), 0.0 if thumb else bone, np.eye(3) - bone, 0.0, 0.0, bone * thumb)[index]
        shift = np.zeros((N_PARTS, 3))
        for part in range(N_PARTS):
            if part:
                parent = PART_PARENT[part]
                shift[part] = shift[parent] + stretch[parent] @ (joints[part] - joints[parent])
            arm = vertices - joints[part]
            basis[:, :, index] += unit * weights[:, part, None] * (shift[part] + arm @ stretch[part])
    return basis


def pose_basis(vertices: Array, joints: Array, moved: Array) -> Array:
    """(V, 3, 135): pose blend shapes that keep flesh at a bent joint from shrinking, which linear blending would cause.

    If a share w of a vertex turns by R about a joint, blending moves the vertex by M = 1 + w (R - 1). This shrinks:
    M^T M = 1 + w (1 - w) (R + R^T - 2). The inverse root of M^T M undoes that. To first order it is
    1 - w (1 - w) / 2 ((R - 1) + (R - 1)^T), which is linear in the entries of R - 1, as pose blend shapes are. It acts
    on the back of the digits alone: on the palm's side a bent joint has too much skin anyway; more would only fold.
    """
    basis = np.zeros((len(vertices), 3, N_PARTS - 1, 3, 3))
    one = np.eye(3)
    for part in range(1, N_PARTS):
        arm = vertices - joints[part]
        on_back = np.clip((arm @ digit(FINGERS[(part - 1) // 3]).back + 0.001) / 0.006, 0.0, 1.0)
        arm = (-0.5 * on_back * moved[:, part] * (1.0 - moved[:, part]))[:, None] * arm
        basis[:, :, part - 1] = np.einsum("ar,vc->varc", one, arm) + np.einsum("ac,vr->varc", one, arm)
    return basis.reshape(len(vertices), 3, 135)


def _poses() -> tuple[Array, Array]:
    """The mean pose (15, 3) and 45 orthonormal components (45, 45), rotation vectors, order of `skeleton.PARTS`.

    The first components are movements of the whole hand: closing it, rolling the fingers in, spreading them, and
    opposing the thumb; then the flexion of each digit; then what is left, joint by joint.
    """
    axes = np.zeros((15, 3, 3))
    for index, finger in enumerate(FINGERS):
        for bone in range(3):
            # Rows: twist, to the side, flexion.
            axes[3 * index + bone] = anatomical_axes(finger, bone, finger_direction(finger))
    mean = np.einsum("j,jk->jk", np.radians(RELAXED_DEG).reshape(15), axes[:, 2])
    closing, rolling, spreading, opposing = np.zeros((4, 5, 3, 3))
    closing[:, :, 2] = [[0.8, 1.0, 0.6]] * 4 + [[0.4, 0.4, 0.5]]
    rolling[:4, :, 2] = [-1.0, 1.0, 0.6]
    spreading[:4, 0, 1] = [1.0, 0.2, -0.5, -1.0]
    opposing[4, 0] = [0.3, 1.0, 0.6]
    digits = np.zeros((5, 5, 3, 3))
    for index in range(5):
        digits[index, index, :, 2] = [1.0, 0.9, 0.6]
    wanted = [closing, rolling, spreading, opposing, *digits]
    rows: list[Array] = []
    for movement in [*(w.reshape(45) for w in wanted), *np.eye(45)]:
        left = movement / np.linalg.norm(movement)
        for _ in range(2):
            # Orthogonalised twice, for numerical accuracy.
            left = left - sum((row @ left) * row for row in rows)
        if np.linalg.norm(left) > 1e-6:
            rows.append(left / np.linalg.norm(left))
    return mean, np.einsum("njk,jkl->njl", np.array(rows).reshape(45, 15, 3), axes).reshape(45, 45)


def write_skin(path: Path) -> None:
    """Write the file; its arrays are always the same."""
    meta = {"format": FORMAT, "schema": SCHEMA, "units": {"length": "m", "angle": "rad"}, "side": "right",
            "licence": licences.PROJECT, "made_by": "dgrasp.hand.free.make_skin",
            "shapes": [name for name, _ in SHAPES]}
    stream = io.BytesIO()
    np.savez_compressed(stream, meta=np.array(json.dumps(meta)), **skin_arrays())  # type: ignore[arg-type]
    write_atomic(path, stream.getvalue())


def main(arguments: list[str]) -> None:
    """Write the model to the given file, by default to the one that ships (`skin_path`)."""
    path = Path(arguments[0]) if arguments else skin_path()
    write_skin(path)
    print(path)


if __name__ == "__main__":
    main(sys.argv[1:])
