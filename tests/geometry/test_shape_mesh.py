from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dgrasp.geometry.closing import close_mesh
from dgrasp.geometry.inertia import shape_properties
from dgrasp.geometry.shape_mesh import shape_mesh
from raisim_like.shapes import Shape
from tests.geometry.solids import box

PLACE = {"position": (0.1, -0.2, 0.05), "quaternion": (0.5, 0.5, 0.5, 0.5)}


@pytest.mark.parametrize(
    "shape",
    [Shape("box", (0.02, 0.03, 0.05), **PLACE), Shape("cylinder", (0.02, 0.05), **PLACE),
     Shape("sphere", (0.03,), **PLACE), Shape("capsule", (0.01, 0.04), **PLACE)],
    ids=lambda s: s.kind,
)
def test_volume_and_place_are_those_of_the_shape(shape: Shape) -> None:
    closed = close_mesh(*shape_mesh(shape))
    exact = shape_properties(shape)
    # The corners of round shapes make up for their edges; those of a capsule overdo it a little.
    off = 0.01 if shape.kind == "capsule" else 1e-3
    assert closed.holes == 0 and closed.volume == pytest.approx(exact.volume, rel=off)
    middle = (closed.vertices.min(axis=0) + closed.vertices.max(axis=0)) / 2
    assert middle == pytest.approx(exact.center_of_mass, abs=1e-4)


@pytest.mark.parametrize("segments", [8, 16, 64])
def test_round_shapes_keep_their_volume_with_any_number_of_corners(segments: int) -> None:
    # A cylinder has two triangles per corner on its side, and segments - 2 on each end; a ball half the square.
    for shape, faces in ((Shape("cylinder", (0.02, 0.05)), 4 * segments - 4),
                         (Shape("sphere", (0.03,)), segments**2 // 2)):
        closed = close_mesh(*shape_mesh(shape, segments))
        assert len(closed.faces) == faces
        assert closed.volume == pytest.approx(shape_properties(shape).volume, rel=1e-6)


def test_a_capsule_stands_along_its_axis() -> None:
    # Radius 1 cm and 4 cm between the balls' middles, turned so that z points along x.
    vertices, _ = shape_mesh(Shape("capsule", (0.01, 0.04), **PLACE))
    assert np.ptp(vertices, axis=0) == pytest.approx([0.06, 0.02, 0.02], rel=0.02)


def test_files(tmp_path: Path) -> None:
    # Two boxes: the hull fills the gap between them, the mesh does not.
    lines, count = [], 0
    for x in (-0.02, 0.02):
        vertices, faces = box((0.02, 0.02, 0.02), (x, 0.0, 0.0))
        lines += [f"v {a:.6f} {b:.6f} {c:.6f}" for a, b, c in vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1 + count).tolist()]
        count += 8
    file = tmp_path / "two.obj"
    file.write_text("\n".join(lines) + "\n")
    assert close_mesh(*shape_mesh(Shape("mesh", file=file))).volume == pytest.approx(16e-6)
    assert close_mesh(*shape_mesh(Shape("hull", file=file))).volume == pytest.approx(24e-6)
    with pytest.raises(ValueError, match="needs a file"):
        shape_mesh(Shape("mesh"))
