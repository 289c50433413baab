"""The hand's surface in a pose: which one is taken, and that it is where the hand is."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from dgrasp.cli import run_command
from dgrasp.errors import DataError
from dgrasp.geometry import approximate
from dgrasp.geometry.inertia import shape_properties
from dgrasp.geometry.intersection import join
from dgrasp.hand.builder.segment import closed_volume
from dgrasp.hand.free.skin import free_skin
from dgrasp.hand.mano.file import read_mano
from dgrasp.hand.mano.skinning import euler_rotations, numpy_skin
from dgrasp.hand.store import NamedHand, open_hand
from dgrasp.hand.surface import COLLISION, PART_MESHES, SKIN, RigidSurface, hand_surface, rigid_surface
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_euler, transform
from tests.hand.mano_file import write_mano
from tests.scenes import free_hand

BETAS = np.array([0.5, -0.3])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hands")
    words = ["--mano", str(write_mano(folder / "MANO_RIGHT.pkl")), "--betas", "0.5", "-0.3", "--shapes", "hulls"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(approximate, "_REPORT_POINTS", 3000)
        for side in ("right", "left"):
            assert run_command("hand build", [*words, "--side", side, "--out", str(folder / side)]) == 0
    return folder


@pytest.fixture(scope="module")
def right(place: Path) -> NamedHand:
    return open_hand(str(place / "right"))


@pytest.fixture
def pose() -> tuple[Array, Array]:
    rng = np.random.default_rng(3)
    T = transform(matrix_from_euler(rng.uniform(-1, 1, 3)), rng.uniform(-0.2, 0.2, 3))
    angles = np.zeros(45)
    angles[2:36:3] = 0.4
    return T, angles


def test_free_hand_has_its_skin(pose: tuple[Array, Array]) -> None:
    surface = hand_surface(free_hand(), None, {})
    assert surface.kind == SKIN
    rotations = np.concatenate([pose[0][None, :3, :3], euler_rotations(pose[1].reshape(15, 3))])[None]
    vertices, _ = numpy_skin(free_skin()).forward(rotations, pose[0][None, :3, 3])
    bounds = np.stack([vertices[0].min(axis=0), vertices[0].max(axis=0)])
    assert join(surface.pieces(*pose)).bounds == pytest.approx(bounds, abs=1e-9)


def test_parts_of_the_free_hand_are_cut_from_its_skin() -> None:
    surface = rigid_surface(free_hand())
    assert surface.kind == PART_MESHES
    flat = np.eye(4), np.zeros(45)
    rigid, skin = (join(s.pieces(*flat)).solid.volume() for s in (surface, hand_surface(free_hand(), None, {})))
    assert rigid == pytest.approx(skin, rel=1e-4)


def test_a_free_hand_of_other_joints_keeps_its_shapes() -> None:
    hand = free_hand()
    longer = dataclasses.replace(hand, chain=dataclasses.replace(hand.chain, offsets=1.1 * hand.offsets))
    assert hand_surface(longer, None, {}).kind == COLLISION


def test_a_hand_without_meshes_has_its_collision_shapes(pose: tuple[Array, Array]) -> None:
    hand = dataclasses.replace(free_hand(), id="somebody's")
    surface = rigid_surface(hand)
    assert surface.kind == COLLISION
    pieces = surface.pieces(*pose)
    shapes = [(part, shape) for part in range(16) for shape in hand.urdf.links[int(hand.part_links[part])].shapes]
    assert len(pieces) == len(shapes)
    R, t = hand.part_poses(pose[0][None], pose[1][None])
    for piece, (part, shape) in zip(pieces, shapes, strict=True):
        exact = shape_properties(shape)
        assert piece.solid.volume() == pytest.approx(exact.volume, rel=0.01)
        middle = R[0, part] @ exact.center_of_mass + t[0, part]
        assert (piece.bounds[0] < middle).all() and (middle < piece.bounds[1]).all()


def test_built_hand_has_its_part_meshes_and_they_are_its_skin_when_flat(right: NamedHand, place: Path) -> None:
    surface = hand_surface(right.model, None, right.meta)
    assert surface.kind == PART_MESHES and isinstance(surface, RigidSurface)
    model = read_mano(place / "MANO_RIGHT.pkl")
    vertices, joints = model.shaped(BETAS)
    whole = closed_volume(vertices, model.faces)
    flat = join(surface.pieces(np.eye(4), np.zeros(45)))
    assert flat.solid.volume() == pytest.approx(whole, rel=0.01)
    # The wrist is the origin of the hand's frame, a corner of the model's mean shape elsewhere.
    assert flat.bounds == pytest.approx(np.stack([vertices.min(axis=0), vertices.max(axis=0)]) - joints[0], abs=2e-5)


def test_skin_is_where_skinning_puts_it_and_counts_once(
    right: NamedHand, place: Path, pose: tuple[Array, Array]
) -> None:
    surface = hand_surface(right.model, place / "MANO_RIGHT.pkl", right.meta)
    assert surface.kind == SKIN
    model = read_mano(place / "MANO_RIGHT.pkl")
    T, angles = pose
    rotations = np.concatenate([T[None, :3, :3], euler_rotations(angles.reshape(15, 3))])[None]
    vertices, _ = numpy_skin(model).forward(rotations, T[None, :3, 3], BETAS[None])
    whole = join(surface.pieces(T, angles))
    assert whole.bounds == pytest.approx(np.stack([vertices[0].min(axis=0), vertices[0].max(axis=0)]), abs=1e-9)
    assert whole.solid.volume() == pytest.approx(closed_volume(vertices[0], model.faces), rel=0.02)
    # A fist runs through itself: the union is smaller than the sum of its parts.
    fist = np.zeros(45)
    fist[2:36:3] = 1.5
    pieces = surface.pieces(T, fist)
    assert join(pieces).solid.volume() < 0.999 * sum(piece.solid.volume() for piece in pieces)


def test_skin_of_a_left_hand(place: Path) -> None:
    left, right = open_hand(str(place / "left")), open_hand(str(place / "right"))
    file = place / "MANO_RIGHT.pkl"
    bounds = [join(hand_surface(h.model, file, h.meta).pieces(np.eye(4), np.zeros(45))).bounds for h in (left, right)]
    assert bounds[0][:, 0] == pytest.approx(-bounds[1][::-1, 0]) and bounds[0][:, 1:] == pytest.approx(bounds[1][:, 1:])


def test_a_model_of_another_hand_is_refused(place: Path, right: NamedHand) -> None:
    with pytest.raises(DataError, match=r"eval\.mano: the joints of .* lie up to .* mm from those of the hand 'free'"):
        hand_surface(free_hand(), place / "MANO_RIGHT.pkl", {})
    with pytest.raises(DataError, match="another_hand"):
        hand_surface(right.model, place / "another_hand.pkl", right.meta)
