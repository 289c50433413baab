"""The skin cut into parts: closed, without gaps, volumes that add up; and points inside of solids."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.geometry.inside import box_points, inner_points, inside_shape, shape_bounds, union_volume
from dgrasp.geometry.part_mesh import PartMesh, mesh_volume
from dgrasp.hand.builder.segment import closed_volume, segment
from dgrasp.hand.mano.file import read_mano
from dgrasp.hand.mano.model import ManoModel
from dgrasp.hand.mano.skeleton import PARTS
from dgrasp.types import Array
from raisim_like.shapes import Shape
from tests.hand.mano_file import write_mano


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ManoModel:
    return read_mano(write_mano(tmp_path_factory.mktemp("mano") / "MANO_RIGHT.pkl"))


def cut(model: ManoModel, weights: Array | None = None) -> tuple[list[PartMesh], Array]:
    vertices, joints = model.shaped(np.array([1.0, -0.5]))
    return segment(vertices, model.faces, model.part_weights() if weights is None else weights, joints), joints


def check(parts: list[PartMesh], joints: Array, model: ManoModel) -> None:
    vertices, _ = model.shaped(np.array([1.0, -0.5]))
    assert [part.name for part in parts] == list(PARTS)
    for part in parts:
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        assert mesh.is_watertight and mesh.is_winding_consistent, part.name
        assert part.volume == pytest.approx(mesh.volume, rel=1e-9) and part.volume > 0
    whole = closed_volume(vertices, model.faces)
    assert sum(part.volume for part in parts) == pytest.approx(whole, rel=1e-12)
    # Every vertex of the skin is in a part, at its place.
    everywhere = np.concatenate([part.vertices + joints[i] for i, part in enumerate(parts)])
    distances = np.linalg.norm(vertices[:, None] - everywhere[None], axis=2).min(axis=1)
    assert distances.max() < 1e-12


def test_parts_are_closed_and_add_up(model: ManoModel) -> None:
    parts, joints = cut(model)
    check(parts, joints, model)
    # The block hand by hand: a middle segment of four cells, rounded; a joint lies in the plane of its part's start.
    by_name = {part.name: part for part in parts}
    assert by_name["palm"].volume > 0.6 * sum(part.volume for part in parts)
    assert abs(by_name["index_middle"].vertices[:, 0].max()) < 0.006


def test_parts_that_touch_their_siblings_and_leave_islands(model: ManoModel) -> None:
    # Random weights: parts of many pieces, with neighbours that they would not have in a hand.
    for seed in range(3):
        noise = np.random.default_rng(seed).random((len(model.template), 16))
        weights = 0.5 * model.part_weights() + 0.5 * noise
        check(*cut(model, weights), model)


def test_a_surface_that_is_no_hand(model: ManoModel) -> None:
    vertices, joints = model.shaped(np.zeros(1))
    weights = model.part_weights()
    with pytest.raises(DataError, match="wound both ways"):
        segment(vertices, np.concatenate([model.faces, model.faces[:1]]), weights, joints)
    without = weights.copy()
    without[:, 11] += without[:, 12]
    without[:, 12] = 0.0
    with pytest.raises(DataError, match="no face of the hand belongs to little_distal"):
        segment(vertices, model.faces, without, joints)
    with pytest.raises(DataError, match="no volume"):
        segment(vertices, model.faces[:, ::-1], weights, joints)


def test_points_inside_a_mesh_and_shapes() -> None:
    box = trimesh.creation.box((0.02, 0.03, 0.05))
    points = inner_points(np.asarray(box.vertices), np.asarray(box.faces), 5000)
    assert len(points) == pytest.approx(5000, rel=0.01) and (np.abs(points) <= [0.01, 0.015, 0.025]).all()
    ball = trimesh.creation.icosphere(3, 0.02)
    inside = inner_points(np.asarray(ball.vertices), np.asarray(ball.faces), 20000)
    assert np.linalg.norm(inside, axis=1).max() <= 0.02
    # A ball fills pi / 6 of its box.
    assert len(inside) / 20000 == pytest.approx(ball.volume / 0.04**3, rel=0.01)
    # Two overlapping boxes in one mesh: their union.
    other = box.copy().apply_translation([0.01, 0.0, 0.0])
    both = trimesh.util.concatenate([box, other])
    union = inner_points(np.asarray(both.vertices), np.asarray(both.faces), 5000)
    assert len(union) == pytest.approx(5000, rel=0.01)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Shape("box", (0.02, 0.03, 0.04), (0.1, 0.0, 0.0), (0.8, 0.6, 0.0, 0.0)), 24e-6),
        (Shape("sphere", (0.02,), (0.1, 0.2, 0.0)), 4 / 3 * np.pi * 8e-6),
        (Shape("cylinder", (0.01, 0.05), (0.0, 0.2, 0.0), (0.6, 0.0, 0.8, 0.0)), np.pi * 5e-6),
        (Shape("capsule", (0.01, 0.05), (0.0, 0.2, 0.0), (0.6, 0.0, 0.8, 0.0)), np.pi * 5e-6 + 4 / 3 * np.pi * 1e-6),
    ],
)
def test_volumes_by_counting(shape: Shape, volume: float, tmp_path: Path) -> None:
    assert union_volume([shape]) == pytest.approx(volume, rel=0.01)
    assert union_volume([shape, shape]) == pytest.approx(volume, rel=0.01)
    low, high = shape_bounds(shape)
    around = box_points(low - 0.02, high + 0.02, 20000)
    inside = around[inside_shape(shape, around)]
    assert (inside >= low - 1e-12).all() and (inside <= high + 1e-12).all()


def test_hull_from_a_file(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.02, 0.03, 0.04))
    box.export(tmp_path / "box.obj")
    shape = Shape("hull", file=tmp_path / "box.obj", position=(0.1, 0.0, 0.0))
    assert union_volume([shape]) == pytest.approx(24e-6, rel=0.01)
    assert mesh_volume(np.asarray(box.vertices), np.asarray(box.faces)) == pytest.approx(24e-6, rel=1e-9)
