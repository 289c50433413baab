"""Load a hand from a URDF: find its parts, their parents and its key points."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.shape_mesh import shapes_vertices
from dgrasp.hand.kinematics import Kinematics
from dgrasp.hand.layout import N_WRIST, Finger, HandLayout, HandNames, Side
from dgrasp.hand.mano.layout import MANO_NAMES, difference_from_mano, mano_rest
from dgrasp.hand.mano.skeleton import FINGERS
from dgrasp.hand.model import HandModel
from dgrasp.types import Array
from raisim_like.errors import UrdfError
from raisim_like.urdf import UrdfModel, read_urdf

THUMB = "thumb"
"""A finger is a thumb if its name, or that of one of its joints, contains this word."""


def load_hand(
    path: Path, hand_id: str, side: Side | None = "right", weight_carried: bool = True, mano: bool = False
) -> HandModel:
    """Load the hand of a URDF. Raises `DataError` for any other URDF.

    The first six joints are the wrist's: prismatic along x, y, z and revolute about x, y, z, all at the base's origin.
    All others are revolute and turn the parts of fingers that hang on the palm, the link of the sixth joint. Joints
    that share an origin turn one part, and the links between them have no shapes. A link fixed to the finger's last
    part marks the fingertip. Without such a link, the fingertip is the farthest point of that part's shapes.

    side: which human hand it resembles. weight_carried: whether an unmodelled arm supports the hand's weight. False for
    the authors' hand, whose palm has its mass on the first slider and hardly pulls the other joints down. mano: refuse
    a hand whose joints are not MANO's. A hand with MANO's joints gets MANO's names, whatever `mano` is.
    """
    try:
        urdf = read_urdf(path)
    except UrdfError as error:
        raise DataError(str(error)) from None
    _check_wrist(path, urdf)
    difference = difference_from_mano(urdf)
    if mano and difference is not None:
        raise DataError(f"{path}: {difference}")
    groups = _parts(path, urdf)
    part_links = np.array([group[-1] for group in groups])
    part_of = {link: part for part, group in enumerate(groups) for link in group}
    parents = np.array([-1, *(part_of[urdf.links[group[0]].parent] for group in groups[1:])])
    offsets = np.array([np.zeros(3), *(urdf.links[group[0]].origin[:3, 3] for group in groups[1:])])
    keypoints = _keypoints(path, urdf, part_links, parents)
    joints = urdf.links[N_WRIST:]
    chain = Kinematics(
        parents, offsets, np.array([part_of[i] for i in range(N_WRIST, urdf.dof)]),
        np.array([link.axis for link in joints]).reshape(-1, 3),
        np.array([link.origin[:3, :3] for link in joints]).reshape(-1, 3, 3),
        np.array([part for part, _, _ in keypoints]), np.array([offset for _, offset, _ in keypoints]),
    )  # fmt: skip
    is_mano = difference is None
    names = MANO_NAMES if is_mano else HandNames(
        tuple(link.joint for link in joints), tuple(urdf.links[link].name for link in part_links),
        tuple(name for _, _, name in keypoints),
    )  # fmt: skip
    layout = _layout(urdf, chain, names, side, FINGERS if is_mano else None)
    limits = urdf.joint_limits
    rest = mano_rest(side or "right") if is_mano else np.zeros(layout.n_joints)
    rest = urdf.ties.coordinates(np.clip(np.concatenate([np.zeros(N_WRIST), rest]), *limits.T))[N_WRIST:]
    return HandModel(
        hand_id, urdf, layout, chain, limits, part_links, rest, urdf.mass if weight_carried else 0.0
    )  # fmt: skip


def _check_wrist(path: Path, urdf: UrdfModel) -> None:
    if urdf.dof <= N_WRIST:
        raise DataError(f"{path}: {urdf.dof} joints; a hand has the wrist's {N_WRIST} and at least one finger joint")
    for i, link in enumerate(urdf.links[:N_WRIST]):
        kind = "prismatic" if i < 3 else "revolute"
        if link.kind != kind or not np.array_equal(link.axis, np.eye(3)[i % 3]):
            raise DataError(f"{path}: joint {i} ({link.joint}) must be {kind} about axis {'xyz'[i % 3]}")
        if not np.allclose(link.origin[:3, :3], np.eye(3), atol=1e-9):
            raise DataError(f"{path}: joint {i} ({link.joint}) is rotated; joint frames must be parallel at zero")
        if np.abs(link.origin[:3, 3]).max() > 1e-12:
            before = "the joint before it" if i else "the hand's base"
            raise DataError(f"{path}: joint {i} ({link.joint}) must share its origin with {before}")
        if link.parent != i - 1:
            raise DataError(f"{path}: joint {i} ({link.joint}) must hang on the joint before it")
    early = [link.joint for link in urdf.links[N_WRIST:] if link.parent < N_WRIST - 1]
    if early:
        raise DataError(f"{path}: joint {early[0]} hangs on a link of the wrist; fingers must hang on the palm, which "
                        f"is the link of joint {urdf.links[N_WRIST - 1].joint}")
    sliding = [link.joint for link in urdf.links[N_WRIST:] if link.kind != "revolute"]
    if sliding:
        raise DataError(f"{path}: joint {sliding[0]} is prismatic; finger joints must be revolute")
    tied = [link.joint for i, link in enumerate(urdf.links) if link.mimic and min(i, link.mimic.leader) < N_WRIST]
    if tied:
        raise DataError(f"{path}: joint {tied[0]} has a <mimic> with a joint of the wrist; expected finger joints "
                        "to follow finger joints")


def _parts(path: Path, urdf: UrdfModel) -> list[list[int]]:
    """Groups of moving links, one per part, the palm first: links that share an origin, up to the one with shapes."""
    children: dict[int, list[int]] = {}
    for i, link in enumerate(urdf.links):
        children.setdefault(link.parent, []).append(i)
    groups, taken = [[N_WRIST - 1]], set[int]()
    for i in range(N_WRIST, urdf.dof):
        if i in taken:
            continue
        group = [i]
        while not urdf.links[group[-1]].shapes and len(below := children.get(group[-1], [])) == 1 and (
            np.abs(urdf.links[below[0]].origin[:3, 3]).max() <= 1e-12
        ):
            group.append(below[0])
        taken.update(group)
        groups.append(group)
    return groups


def _keypoints(path: Path, urdf: UrdfModel, part_links: Array, parents: Array) -> list[tuple[int, Array, str]]:
    """(part, offset in its frame, name) of each key point: the wrist, each part's origin, and each finger's tip."""
    points: list[tuple[int, Array, str]] = [(0, np.zeros(3), "wrist")]
    for part in range(1, len(part_links)):
        link = urdf.links[int(part_links[part])]
        points.append((part, np.zeros(3), link.name))
        if part not in parents:
            points.append((part, *_tip(path, urdf, int(part_links[part]))))
    return points


def _tip(path: Path, urdf: UrdfModel, index: int) -> tuple[Array, str]:
    """The fingertip in the frame of the link `index`, and its name."""
    link = urdf.links[index]
    marks = [(name, T) for name, (i, T) in urdf.frames.items() if i == index and name != link.name]
    if len(marks) > 1:
        named = [mark for mark in marks if "tip" in mark[0].lower()]
        marks = named if len(named) == 1 else []
    if marks:
        return marks[0][1][:3, 3], marks[0][0]
    if not link.shapes:
        raise DataError(f"{path}: link {link.name} needs one fixed child link that marks the fingertip, or collision "
                        "shapes")
    vertices = shapes_vertices(link.shapes)
    return vertices[np.linalg.norm(vertices, axis=1).argmax()], f"{link.name}_tip"


def _layout(
    urdf: UrdfModel, chain: Kinematics, names: HandNames, side: Side | None, finger_names: tuple[str, ...] | None
) -> HandLayout:
    finger_of = [-1]
    for parent in chain.parents[1:].tolist():
        finger_of.append(max(finger_of) + 1 if parent == 0 else finger_of[parent])
    fingers = []
    for index in range(max(finger_of) + 1):
        parts = [part for part, finger in enumerate(finger_of) if finger == index]
        joints = np.flatnonzero(np.isin(chain.joint_parts, parts)).tolist()
        points = np.flatnonzero(np.isin(chain.keypoint_parts, parts)).tolist()
        name = names.parts[parts[0]] if finger_names is None else finger_names[index]
        fingers.append(Finger(name, tuple(joints), tuple(parts), tuple(points)))
    away = (chain.keypoint_offsets != 0.0).any(axis=1)
    outer = ~np.isin(np.arange(len(chain.parents)), chain.parents)
    tips = tuple(np.flatnonzero(away & outer[chain.keypoint_parts]).tolist())
    thumbs = [
        index for index, finger in enumerate(fingers)
        if any(THUMB in name.lower() for name in (finger.name, *(names.joints[j] for j in finger.joints)))
    ]  # fmt: skip
    return HandLayout(names, tuple(fingers), tips, thumbs[0] if len(thumbs) == 1 else None, side)
