"""Which shape is chosen, by volume overlap and by the distances between the surfaces."""

from __future__ import annotations

from pathlib import Path

import manifold3d
import numpy as np
import pytest
import trimesh

from dgrasp.errors import DataError
from dgrasp.objects.add import fit
from dgrasp.objects.add.fit import fit_primitive, fit_shapes, union_overlap
from dgrasp.objects.add.repair import RepairedSolid, repair
from dgrasp.types import Array
from raisim_like.shapes import Shape
from raisim_like.urdf import shape_pose
from tests.objects.meshes import SIZE, box


def solid(mesh: trimesh.Trimesh) -> RepairedSolid:
    return repair(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Askew and away from the origin."""
    made = mesh.copy()
    made.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1.0, 2.0, 0.5), (0.1, 0.0, 0.2)))
    return made


TORUS = trimesh.creation.torus(0.05, 0.015, major_sections=48, minor_sections=24)


@pytest.fixture
def hull_for_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces the slow cutter: gives the solid's own hull."""

    def parts(made: RepairedSolid, finer: bool) -> list[tuple[Array, Array]]:
        hull = trimesh.Trimesh(*made.mesh, process=False).convex_hull
        return [(np.asarray(hull.vertices), np.asarray(hull.faces))]

    monkeypatch.setattr(fit, "part_hulls", parts)


def test_overlap_by_hand() -> None:
    a = solid(box())
    # Half a length along: the intersection is a half, the union one and a half. Two shapes count as their union.
    shifted = Shape("box", SIZE, (0.03, 0.0, 0.0))
    assert union_overlap(a, (shifted,)) == pytest.approx(1 / 3)
    assert union_overlap(a, (shifted, shifted, Shape("box", SIZE))) == pytest.approx(2 / 3)
    assert union_overlap(a, (Shape("box", SIZE, (0.5, 0.0, 0.0)),)) == 0.0
    assert union_overlap(a, (Shape("box", SIZE),)) == pytest.approx(1.0)


def test_a_box_is_found_exactly_however_it_lies(tmp_path: Path) -> None:
    made = fit_shapes(solid(turned(box())), tmp_path)
    assert made.kind == "box" and made.overlap == pytest.approx(1.0, abs=1e-4) and not list(tmp_path.iterdir())
    assert sorted(made.shapes[0].size) == pytest.approx(sorted(SIZE), abs=1e-5)
    assert set(made.tried) == {"box", "cylinder", "sphere", "capsule"} and made.tried["sphere"] < 0.8


@pytest.mark.parametrize(
    ("kind", "mesh", "size"),
    [
        ("cylinder", trimesh.creation.cylinder(0.03, 0.1, sections=48), (0.03, 0.1)),
        ("sphere", trimesh.creation.icosphere(3, 0.04), (0.04,)),
        ("capsule", trimesh.creation.capsule(0.06, 0.02, count=(24, 24)), (0.02, 0.06)),
    ],
)
def test_round_shapes_are_found(kind: str, mesh: trimesh.Trimesh, size: tuple[float, ...]) -> None:
    found = fit_primitive(solid(turned(mesh)), kind)
    assert found is not None and found[0].kind == kind and found[1] > 0.97
    assert found[0].size == pytest.approx(size, rel=0.02)


@pytest.mark.parametrize(
    ("kind", "mesh"),
    [
        ("cylinder", trimesh.creation.cylinder(0.008, 0.14, sections=24)),  # a marker
        ("cylinder", trimesh.creation.cylinder(0.0035, 0.175, sections=6)),  # a pencil
        ("capsule", trimesh.creation.capsule(0.06, 0.02, count=(24, 24))),
        ("sphere", trimesh.creation.icosphere(2, 0.04)),
    ],
)
def test_round_shapes_are_balanced(kind: str, mesh: trimesh.Trimesh) -> None:
    # A fit to counted points is some hundredths of a millimetre off. A lying bar then rolls, with true inertia.
    mesh = turned(mesh)
    found = fit_primitive(solid(mesh), kind)
    assert found is not None
    T = shape_pose(found[0])
    away = T[:3, :3].T @ (np.asarray(mesh.center_mass) - T[:3, 3])
    assert np.linalg.norm(away[: 3 if kind == "sphere" else 2]) < 1e-7
    if kind == "cylinder":
        # It ends where the bar does.
        assert away[2] == pytest.approx(0.0, abs=1e-7)
        assert found[0].size[1] == pytest.approx(np.ptp((mesh.vertices - mesh.center_mass) @ T[:3, 2]))
    if kind != "sphere":
        true = trimesh.transformations.rotation_matrix(0.7, (1.0, 2.0, 0.5))[:3, 2]
        assert abs(T[:3, 2] @ true) == pytest.approx(1.0, abs=1e-9)


def test_a_round_shape_stays_where_the_weight_is_to_one_side() -> None:
    # A lug of 9 cm3 on a can of 283 cm3: its centre of mass is 1.4 mm beside the axis, which is no error of the fit.
    can = trimesh.creation.cylinder(0.03, 0.1, sections=48)
    lug = trimesh.creation.box((0.03, 0.01, 0.03), trimesh.transformations.translation_matrix((0.043, 0.0, 0.0)))
    both = trimesh.boolean.union([can, lug], engine="manifold")
    found = fit_primitive(solid(both), "cylinder")
    assert found is not None and both.center_mass[0] > 1e-3
    assert np.linalg.norm(np.array(found[0].position[:2]) - both.center_mass[:2]) > 6e-4


def test_a_thin_sheet_is_a_box(tmp_path: Path) -> None:
    made = fit_shapes(solid(turned(box((0.2, 0.15, 0.0005)))), tmp_path, "box")
    assert made.overlap > 0.99 and min(made.shapes[0].size) == pytest.approx(0.0005, rel=0.01)


@pytest.mark.usefixtures("hull_for_parts")
def test_a_torus_is_no_primitive(tmp_path: Path) -> None:
    made = fit_shapes(solid(TORUS), tmp_path)
    # The hull fills the hole: 2 pi^2 R r^2 = 222 cm3 of about 361 cm3.
    assert made.kind == "parts" and made.overlap == pytest.approx(0.615, abs=0.04)
    assert all(made.tried[kind] < 0.7 for kind in ("box", "cylinder", "sphere", "capsule"))
    # The flat ends of the hull are farthest from the ring in the middle: sqrt(R^2 + r^2) - r, less a speck around it.
    assert made.gaps.largest == pytest.approx(np.hypot(0.05, 0.015) - 0.015, abs=0.003)
    assert made.gaps.share_close < 0.7


@pytest.mark.usefixtures("hull_for_parts")
def test_a_primitive_that_leaves_out_a_handle_is_refused(tmp_path: Path) -> None:
    can = manifold3d.Manifold.cylinder(0.1, 0.035, circular_segments=48)
    lug = manifold3d.Manifold.cube((0.008, 0.01, 0.03)).translate((0.035, -0.005, 0.035))
    plain, lugged = RepairedSolid(can, ()), RepairedSolid(can + lug, ())
    assert fit_shapes(plain, tmp_path).kind == "cylinder"
    made = fit_shapes(lugged, tmp_path)
    # The lug is 0.6% of the volume, and 8 mm from the cylinder.
    assert made.kind == "parts" and made.tried["cylinder"] > 0.97
    assert fit_shapes(lugged, tmp_path, "cylinder").gaps.largest == pytest.approx(0.008, abs=0.001)


def test_the_choice_can_be_made_by_hand(tmp_path: Path, hull_for_parts: None) -> None:
    assert fit_shapes(solid(TORUS), tmp_path, "parts").kind == "parts"
    made = fit_shapes(solid(TORUS), tmp_path, "sphere")
    assert made.kind == "sphere" and made.overlap < 0.6 and set(made.tried) == {"sphere"}
    # By volume: r^3 = 3 / (4 pi) 2 pi^2 R r^2.
    assert made.shapes[0].size[0] ** 3 == pytest.approx(1.5 * np.pi * 0.05 * 0.015**2, rel=0.03)
    assert fit_shapes(solid(box()), tmp_path, "mesh").overlap == pytest.approx(1.0)


def test_triangles_are_thinned_out_by_less_than_a_millimetre(tmp_path: Path) -> None:
    fine = trimesh.creation.torus(0.05, 0.015, major_sections=96, minor_sections=48)
    made = fit_shapes(solid(fine), tmp_path, "mesh")
    (shape,) = made.shapes
    assert shape.kind == "mesh" and shape.file is not None
    assert len(trimesh.load(shape.file, force="mesh").faces) <= fit.COLLISION_FACES < len(fine.faces)
    assert made.gaps.largest < 0.0011 and made.overlap > 0.95 and made.gaps.remarks() == []


def test_no_parts_at_all_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "part_hulls", lambda solid, finer: [])
    with pytest.raises(DataError, match="no convex parts can be made because the solid is too thin"):
        fit_shapes(solid(box()), tmp_path, "parts")


def test_parts_that_are_far_off_are_made_again_finer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At first half of a bar of 100 mm, then the whole bar."""
    asked: list[bool] = []

    def parts(made: RepairedSolid, finer: bool) -> list[tuple[Array, Array]]:
        asked.append(finer)
        bar = trimesh.creation.box((0.1 if finer else 0.05, 0.02, 0.02))
        return [(np.asarray(bar.vertices), np.asarray(bar.faces))]

    monkeypatch.setattr(fit, "part_hulls", parts)
    bar = trimesh.creation.box((0.1, 0.02, 0.02))
    fitted = fit_shapes(repair(np.asarray(bar.vertices), np.asarray(bar.faces)), tmp_path, "parts")
    assert asked == [False, True] and fitted.gaps.share_close == 1.0 and fitted.overlap == pytest.approx(1.0)
