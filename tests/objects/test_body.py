from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgrasp.objects.body import DETAILED_MESH, object_body, surface_points
from dgrasp.objects.free import free_object
from tests.geometry.solids import box


def test_collision_shapes_unless_there_is_a_mesh(tmp_path: Path) -> None:
    model = free_object("025_mug", "official", False)
    made = object_body(model, tmp_path / "nowhere")
    assert model.mesh is not None and made.own and not made.detailed
    model = replace(free_object("004_sugar_box", "official", False), mesh=None)
    made = object_body(model, tmp_path / "nowhere")
    assert not made.detailed and not made.own and made.body.solid.volume() == pytest.approx(0.038 * 0.089 * 0.175)
    folder = tmp_path / model.name
    folder.mkdir()
    vertices, faces = box((0.02, 0.02, 0.02))
    lines = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()] + [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    (folder / DETAILED_MESH).write_text("\n".join(lines) + "\n")
    made = object_body(model, tmp_path)
    assert made.detailed and not made.own and made.body.solid.volume() == pytest.approx(8e-6)


def test_a_compound_counts_its_overlaps_once() -> None:
    model = replace(free_object("025_mug", "official", False), mesh=None)
    made = object_body(model, Path("nowhere")).body
    each = sum(object_body(type(model)("x", (shape,), 1.0, np.zeros(3), np.eye(3)), Path("nowhere")).body.solid.volume()
               for shape in model.shapes)
    assert 0.5 * each < made.solid.volume() < 0.99 * each


def test_surface_points_lie_on_the_surface_and_leave_no_gaps() -> None:
    points = surface_points(object_body(free_object("061_foam_brick", "official", False), Path("nowhere")).body, 0.004)
    half = np.array([0.025, 0.0375, 0.025])
    assert np.abs(np.abs(points) / half).max() == pytest.approx(1.0)
    assert (np.abs(np.abs(points) - half).min(axis=1) < 1e-9).all()
    rng = np.random.default_rng(0)
    somewhere = rng.uniform(-1, 1, (200, 3)) * half
    somewhere[:, 0] = half[0]
    gaps = np.linalg.norm(somewhere[:, None] - points[None], axis=2).min(axis=1)
    assert gaps.max() < 0.004
