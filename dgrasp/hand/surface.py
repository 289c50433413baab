"""The hand's surface in any pose: the skinned mesh, its rigid parts, or its collision shapes, whichever exists."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.intersection import Body, body
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.hand.builder.segment import segment
from dgrasp.hand.free.skin import HAND_NAME, SKIN_FILE, free_skin
from dgrasp.hand.mano.file import read_mano
from dgrasp.hand.mano.model import ManoModel, mirror_mano
from dgrasp.hand.mano.skeleton import N_PARTS, PART_PARENT
from dgrasp.hand.mano.skinning import numpy_skin
from dgrasp.hand.model import HandModel
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_euler, transform
from raisim_like.shapes import Shape

SKIN, PART_MESHES, COLLISION = "skinned mesh", "part meshes", "collision shapes"
"""Kinds of surface; the first is the paper's."""

SAME_JOINTS = 0.002
"""m. A MANO model belongs to a hand if the joints of both lie this close together."""


class HandSurface(Protocol):
    """A hand's surface; `kind` says what it is made of."""

    kind: str

    def pieces(self, T_AH: Array, hand_pose: Array) -> list[Body]:
        """Closed bodies in frame A whose union is the hand, for its wrist (4, 4) and finger angles (J,)."""


class RigidSurface:
    """Bodies that move with the parts: pieces[i] (in its part's frame) moves with parts[i]."""

    def __init__(self, kind: str, hand: HandModel, parts: list[int], pieces: list[Body]) -> None:
        self.kind, self._hand, self._parts, self._pieces = kind, hand, parts, pieces

    def local(self, part: int) -> list[Body]:
        """The bodies that move with a part, in its frame."""
        return [piece for p, piece in zip(self._parts, self._pieces, strict=True) if p == part]

    def pieces(self, T_AH: Array, hand_pose: Array) -> list[Body]:
        R, t = self._hand.part_poses(T_AH[None], hand_pose[None])
        return [piece.placed(transform(R[0, part], t[0, part]))
                for part, piece in zip(self._parts, self._pieces, strict=True)]


class SkinnedSurface:
    """A skinned model cut into 16 closed pieces, so that overlaps of a hand with itself are not counted twice."""

    kind = SKIN

    def __init__(self, model: ManoModel, betas: Array) -> None:
        self._skin, self._faces, self._weights = numpy_skin(model), model.faces, model.part_weights()
        self._betas = np.asarray(betas, dtype=float)[None]

    def pieces(self, T_AH: Array, hand_pose: Array) -> list[Body]:
        rotations = np.empty((1, N_PARTS, 3, 3))
        rotations[0, 0] = T_AH[:3, :3]
        rotations[0, 1:] = matrix_from_euler(hand_pose.reshape(-1, 3))
        vertices, _ = self._skin.forward(rotations, T_AH[None, :3, 3], self._betas)
        parts = segment(vertices[0], self._faces, self._weights, np.zeros((N_PARTS, 3)))
        return [body([(part.vertices, part.faces)]) for part in parts]


def hand_surface(hand: HandModel, mano: Path | None, meta: dict[str, Any]) -> HandSurface:
    """The best available surface: skinned if `mano` names MANO's file or the hand is the free one, else the part
    meshes, else the collision shapes.

    meta: how the hand was made (`store.NamedHand.meta`), for its side and shape; empty for the mean shape of a right
    hand. Raises `DataError` if the file is not a MANO hand, or is another hand than this one.
    """
    if mano is not None:
        return _skinned(hand, mano, meta)
    return _free_skinned(hand, meta) or rigid_surface(hand)


def rigid_surface(hand: HandModel) -> RigidSurface:
    """The part meshes (for the free hand, of its skin), else the collision shapes. Raises `DataError` without both."""
    meshes = _part_meshes(hand) or _skin_parts(hand)
    if meshes is not None:
        return RigidSurface(PART_MESHES, hand, list(range(hand.layout.n_parts)), meshes)
    parts, pieces = [], []
    for part in range(hand.layout.n_parts):
        for shape in hand.urdf.links[int(hand.part_links[part])].shapes:
            parts.append(part)
            pieces.append(body([shape_mesh(shape)]))
    if not pieces:
        raise DataError(f"{hand.urdf.path}: neither meshes nor collision shapes; expected a hand with one of them")
    return RigidSurface(COLLISION, hand, parts, pieces)


def _skinned(hand: HandModel, file: Path, meta: dict[str, Any]) -> SkinnedSurface:
    try:
        model, betas, _ = mano_of_hand(file, hand.offsets, hand.id, meta)
    except DataError as error:
        raise DataError(f"eval.mano: {error}; leave eval.mano out to measure on the hand's own shapes") from None
    return SkinnedSurface(model, betas)


def _free_skinned(hand: HandModel, meta: dict[str, Any]) -> SkinnedSurface | None:
    """The free hand's skin, for the free hand and for hands that were built from it; None for another hand."""
    if hand.id != HAND_NAME and meta.get("model_file") != SKIN_FILE:
        return None
    model, betas, joints = _shaped(free_skin(), meta)
    return SkinnedSurface(model, betas) if _apart(joints, hand.offsets) <= SAME_JOINTS else None


def _skin_parts(hand: HandModel) -> list[Body] | None:
    """The parts of the free hand's skin in their frames; None for another hand."""
    model = free_skin()
    vertices, joints = model.shaped(np.zeros(0))
    if hand.id != HAND_NAME or _apart(joints, hand.offsets) > SAME_JOINTS:
        return None
    parts = segment(vertices, model.faces, model.part_weights(), joints)
    return [body([(part.vertices, part.faces)]) for part in parts]


def mano_of_hand(file: Path, offsets: Array, hand_id: str, meta: dict[str, Any]) -> tuple[ManoModel, Array, Array]:
    """MANO's model of a hand's side, with the hand's betas (S',) and joints (P, 3) m, order of `skeleton.PARTS`.

    offsets: the hand's own, m. meta: side and betas, as in `hand_surface`. Raises `DataError` if the file is not a MANO
    hand, or is another hand than this one.
    """
    model, betas, joints = _shaped(read_mano(file), meta)
    off = _apart(joints, offsets)
    if off > SAME_JOINTS:
        raise DataError(f"the joints of {file} lie up to {1000 * off:.1f} mm from those of the hand {hand_id!r}; "
                        "expected the model that the hand was made from")
    return model, betas, joints


def _shaped(model: ManoModel, meta: dict[str, Any]) -> tuple[ManoModel, Array, Array]:
    """The model of the hand's side, with the hand's betas (S',) and joints, m."""
    if meta.get("side", "right") != model.side:
        model = mirror_mano(model)
    betas = np.array(meta.get("betas", []), dtype=float)
    return model, betas, model.shaped(betas)[1]


def _apart(joints: Array, offsets: Array) -> float:
    """m: largest difference between the offsets of MANO's joints and those of a hand; inf if its parts are not MANO's.
    """
    if len(offsets) != N_PARTS:
        return float("inf")
    own = np.array([joints[i] - joints[PART_PARENT[i]] for i in range(1, N_PARTS)])
    return float(np.linalg.norm(own - offsets[1:], axis=1).max())


def _part_meshes(hand: HandModel) -> list[Body] | None:
    """The parts' visual meshes, one body per part; None unless every part has a mesh whose file exists."""
    visuals: list[list[tuple[Array, Array]]] = [[] for _ in range(hand.layout.n_parts)]
    part_of = {int(link): part for part, link in enumerate(hand.part_links)}
    text = hand.urdf.path.read_text(encoding="utf-8")
    # The XML declaration is skipped, as in `read_urdf`: a wrong version in it does no harm.
    root = ElementTree.fromstring(text.partition("?>")[2] if text.lstrip().startswith("<?xml") else text)
    for element in root.findall("link"):
        link, T_link = hand.urdf.frames[element.get("name") or ""]
        for visual in element.findall("visual"):
            node = visual.find("geometry/mesh")
            if node is None or link not in part_of:
                continue
            file = hand.urdf.path.parent / (node.get("filename") or "")
            if not file.is_file():
                return None
            T = T_link @ _origin(visual)
            vertices, faces = shape_mesh(Shape("mesh", file=file))
            visuals[part_of[link]].append((vertices @ T[:3, :3].T + T[:3, 3], faces))
    return [body(meshes) for meshes in visuals] if all(visuals) else None


def _origin(element: ElementTree.Element) -> Array:
    node = element.find("origin")
    if node is None:
        return np.eye(4)
    xyz, rpy = (np.array([float(word) for word in node.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    # URDF turns about fixed axes: R = Rz Ry Rx.
    x, y, z = (matrix_from_euler(np.eye(3)[i] * rpy[i]) for i in range(3))
    return transform(z @ y @ x, xyz)
