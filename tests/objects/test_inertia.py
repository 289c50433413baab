"""Mass properties against closed forms worked out by hand, and against each other."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from dgrasp.errors import DataError
from dgrasp.geometry.inertia import (
    box_properties,
    capsule_properties,
    combine,
    cylinder_properties,
    load_mesh,
    mesh_properties,
    shape_properties,
    sphere_properties,
)
from dgrasp.objects.model import object_model
from raisim_like.rotations import matrix_from_euler, quaternion_from_matrix
from raisim_like.shapes import Shape

size = st.floats(0.01, 1.0)
QUARTER_ABOUT_X = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)


def write(mesh: trimesh.Trimesh, path: Path) -> Path:
    mesh.export(path)
    return path


def test_box() -> None:
    body = box_properties(1.0, 2.0, 3.0)
    # I_x = m (y^2 + z^2) / 12 with m = 6: 6 * 13 / 12.
    assert body.volume == 6.0
    assert body.inertia == pytest.approx(np.diag([6.5, 5.0, 2.5]))
    assert body.inertia_of(12.0) == pytest.approx(np.diag([13.0, 10.0, 5.0]))


def test_cylinder() -> None:
    body = cylinder_properties(2.0, 3.0)
    # m = 12 pi; I_z = m r^2 / 2 = 24 pi; I_x = m (3 * 4 + 9) / 12 = 21 pi.
    assert body.volume == pytest.approx(12 * math.pi)
    assert body.inertia == pytest.approx(np.diag([21, 21, 24]) * math.pi)


def test_sphere() -> None:
    # m = 4/3 pi 27 = 36 pi; I = 2/5 m 9 = 129.6 pi.
    assert sphere_properties(3.0).inertia == pytest.approx(129.6 * math.pi * np.eye(3))


def test_capsule_without_length_is_a_sphere() -> None:
    assert capsule_properties(0.3, 0.0).inertia == pytest.approx(sphere_properties(0.3).inertia)


def test_capsule_by_hand() -> None:
    body = capsule_properties(1.0, 2.0)
    # Barrel 2 pi: I_z = pi, I_x = 2 pi (3 + 4) / 12. Ball 4/3 pi: I_z = 8/15 pi,
    # I_x = 4/3 pi (2/5 + 2^2/4 + 3/8 * 2 * 1).
    assert body.volume == pytest.approx(10 / 3 * math.pi)
    across = (7 / 6 + 4 / 3 * 2.15) * math.pi
    assert body.inertia == pytest.approx(np.diag([across, across, (1 + 8 / 15) * math.pi]))


def test_capsule_against_a_fine_mesh(tmp_path: Path) -> None:
    file = write(trimesh.creation.capsule(height=0.08, radius=0.02, count=[96, 96]), tmp_path / "capsule.stl")
    fine = mesh_properties(file)
    exact = capsule_properties(0.02, 0.08)
    assert fine.volume == pytest.approx(exact.volume, rel=5e-3)
    assert np.diag(fine.inertia) == pytest.approx(np.diag(exact.inertia), rel=1e-2)


def test_two_cubes_are_a_box() -> None:
    cubes = [box_properties(1, 1, 1).moved(np.array([x, 5.0, 0.0]), np.eye(3)) for x in (-0.5, 0.5)]
    whole = combine(cubes)
    assert whole.center_of_mass == pytest.approx([0.0, 5.0, 0.0])
    assert whole.inertia == pytest.approx(box_properties(2, 1, 1).inertia)


def test_dumbbell() -> None:
    # Two balls of volume v at +-2 along x: I_x = 2 * 0.4 v r^2, I_y = I_x + 2 v 4.
    ball = sphere_properties(0.1)
    whole = combine(ball.moved(np.array([x, 0.0, 0.0]), np.eye(3)) for x in (-2.0, 2.0))
    v = ball.volume
    assert np.diag(whole.inertia) == pytest.approx([0.008 * v, 8.008 * v, 8.008 * v])


def test_an_overlap_counts_twice() -> None:
    assert combine([box_properties(1, 1, 1)] * 2).volume == 2.0


def test_combine_needs_a_part() -> None:
    with pytest.raises(ValueError, match="at least one"):
        combine([])


def test_shapes_are_placed_and_turned() -> None:
    # A cylinder turned from z to y: its small moment is now about y.
    shape = Shape("cylinder", (1.0, 6.0), (0.1, 0.2, 0.3), QUARTER_ABOUT_X)
    body = shape_properties(shape)
    small, large = np.diag(cylinder_properties(1.0, 6.0).inertia)[[2, 0]]
    assert np.diag(body.inertia) == pytest.approx([large, small, large])
    assert body.center_of_mass == pytest.approx([0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    "shape", [Shape("box", (0.1, 0.2, 0.3)), Shape("sphere", (0.2,)), Shape("capsule", (0.1, 0.2))]
)
def test_each_primitive_is_known(shape: Shape) -> None:
    direct = {"box": box_properties, "sphere": sphere_properties, "capsule": capsule_properties}[shape.kind]
    assert shape_properties(shape).inertia == pytest.approx(direct(*shape.size).inertia)


@given(a=size, b=size, c=size, angles=st.tuples(*[st.floats(-3, 3)] * 3), shift=st.tuples(*[st.floats(-1, 1)] * 3))
def test_a_compound_does_not_depend_on_the_frame(
    a: float, b: float, c: float, angles: tuple[float, ...], shift: tuple[float, ...]
) -> None:
    R, t = matrix_from_euler(np.array(angles)), np.array(shift)
    parts = [box_properties(a, b, c), capsule_properties(a, b).moved(np.array([c, 0.0, a]), np.eye(3))]
    whole, moved = combine(parts), combine([part.moved(t, R) for part in parts])
    assert moved.center_of_mass == pytest.approx(R @ whole.center_of_mass + t, abs=1e-9)
    assert moved.inertia == pytest.approx(R @ whole.inertia @ R.T, abs=1e-9)


def test_closed_mesh_is_integrated_not_hulled(tmp_path: Path) -> None:
    # An L of three unit cubes has volume 3; its hull has 3.5.
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    faces = []
    vertices = [(x, y, z) for z in (0, 1) for x, y in outline]
    for i in range(6):
        j = (i + 1) % 6
        faces += [(i, j, j + 6), (i, j + 6, i + 6)]
    for a, b, c in ((0, 1, 3), (1, 2, 3), (0, 3, 5), (3, 4, 5)):
        faces += [(c, b, a), (a + 6, b + 6, c + 6)]
    file = write(trimesh.Trimesh(vertices, faces, process=False), tmp_path / "ell.obj")
    body = mesh_properties(file)
    assert body.volume == pytest.approx(3.0)
    # Cubes at (.5, .5), (1.5, .5), (.5, 1.5): the centre of mass is their mean.
    assert body.center_of_mass == pytest.approx([5 / 6, 5 / 6, 0.5])
    by_cubes = combine(
        box_properties(1, 1, 1).moved(np.array([x, y, 0.5]), np.eye(3)) for x, y in ((0.5, 0.5), (1.5, 0.5), (0.5, 1.5))
    )
    assert body.inertia == pytest.approx(by_cubes.inertia)
    assert mesh_properties(file, convex=True).volume == pytest.approx(3.5)


def test_open_mesh_falls_back_to_its_hull(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    keep = box.face_normals[:, 2] < 0.5
    opened = trimesh.Trimesh(box.vertices, box.faces[keep])
    assert not opened.is_watertight
    body = mesh_properties(write(opened, tmp_path / "open.obj"))
    assert body.volume == pytest.approx(0.006)
    assert body.inertia == pytest.approx(box_properties(0.1, 0.2, 0.3).inertia)


def test_vertices_split_by_texture_are_merged(tmp_path: Path) -> None:
    # A cube whose triangles share no vertex, as exporters write it: still closed after loading.
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    loose = trimesh.Trimesh(box.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    mesh = load_mesh(write(loose, tmp_path / "loose.obj"))
    assert len(mesh.vertices) == 8 and mesh.is_volume


def test_negative_indices_count_from_the_last_vertex_so_far(tmp_path: Path) -> None:
    text = ""
    for x in (0.0, 3.0):
        text += "".join(f"v {x + i} {j} {k}\n" for i in (0, 1) for j in (0, 1) for k in (0, 1))
        for quad in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)):
            text += "f " + " ".join(str(i - 8) for i in quad) + "\n"
    (tmp_path / "two.obj").write_text(text)
    mesh = load_mesh(tmp_path / "two.obj")
    # Two cubes of 1 m, 2 m apart.
    assert mesh.volume == pytest.approx(2.0) and mesh.bounds.tolist() == [[0, 0, 0], [4, 1, 1]]


def test_missing_mesh_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nowhere\.obj: this mesh does not exist"):
        mesh_properties(tmp_path / "nowhere.obj")


@pytest.mark.parametrize(
    "text", ["", "not a mesh\n", "v 0 0 0\nv 1 0 0\n", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "v 0 0 nan\nf 1 1 1\n"]
)
def test_damaged_mesh_is_named(tmp_path: Path, text: str) -> None:
    file = tmp_path / "bad.obj"
    file.write_text(text)
    with pytest.raises(DataError, match=r"bad\.obj: "):
        mesh_properties(file)


@pytest.mark.parametrize("z", ["0 0 0 0", "0 1 3 2"])
def test_flat_mesh_is_refused(tmp_path: Path, z: str) -> None:
    # A square in the plane z = 0 and in the tilted plane z = x + 2 y.
    a, b, c, d = z.split()
    file = tmp_path / "flat.obj"
    file.write_text(f"v 0 0 {a}\nv 1 0 {b}\nv 1 1 {c}\nv 0 1 {d}\nf 1 2 3\nf 1 3 4\n")
    with pytest.raises(DataError, match=r"flat\.obj: the mesh is flat"):
        mesh_properties(file)


def test_object_model_true_and_compatible() -> None:
    shapes = [Shape("box", (1.0, 1.0, 1.0), (0.5, 0.0, 0.0)), Shape("box", (1.0, 1.0, 1.0), (-0.5, 0.0, 0.0))]
    true = object_model("thing", shapes, 12.0, official_compat=False)
    # A 2 x 1 x 1 box of 12 kg: I_x = 1 * (1 + 1), I_y = I_z = 1 * (1 + 4).
    assert true.inertia == pytest.approx(np.diag([2.0, 5.0, 5.0]))
    assert true.center_of_mass_O == pytest.approx(np.zeros(3))
    compatible = object_model("thing", shapes, 12.0, official_compat=True)
    assert np.array_equal(compatible.inertia, np.eye(3)) and np.array_equal(compatible.center_of_mass_O, np.zeros(3))
    assert compatible.shapes == true.shapes == tuple(shapes) and compatible.mass == true.mass == 12.0


def test_turning_a_shape_turns_its_inertia() -> None:
    R = matrix_from_euler(np.array([0.3, -0.8, 1.9]))
    w, x, y, z = quaternion_from_matrix(R)
    turned = shape_properties(Shape("box", (0.1, 0.2, 0.3), quaternion=(w, x, y, z)))
    assert turned.inertia == pytest.approx(R @ box_properties(0.1, 0.2, 0.3).inertia @ R.T, abs=1e-15)
