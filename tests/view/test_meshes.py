from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgrasp.geometry.intersection import Body, body
from dgrasp.hand.mano.skeleton import N_PARTS
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import object_model
from dgrasp.types import Array
from dgrasp.view.camera import viewpoint
from dgrasp.view.meshes import (
    OBJECT_FACES,
    PART_FACES,
    Mesh,
    blendable,
    body_poses,
    hand_meshes,
    hand_shapes,
    light,
    merged,
    object_shapes,
    scene_meshes,
    table_tops,
)
from raisim_like.rotations import matrix_from_euler, matrix_from_quaternion
from raisim_like.shapes import Shape
from tests.eval.records import standing
from tests.export.sequences import STEPS, box, episode, meshes
from tests.scenes import free_hand


def ball(n: int) -> Mesh:
    """A ball of radius 0.05 m with 4 n (n - 1) triangles."""
    polar, turn = np.linspace(0.0, np.pi, n + 1), np.linspace(0.0, 2 * np.pi, 2 * n, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rows = [np.column_stack([np.sin(p) * ring, np.full(2 * n, np.cos(p))]) for p in polar[1:-1]]
    vertices = 0.05 * np.concatenate([[[0.0, 0.0, 1.0]], *rows, [[0.0, 0.0, -1.0]]])
    faces, last = [], len(vertices) - 1
    for k in range(2 * n):
        near = (k + 1) % (2 * n)
        faces += [[0, 1 + k, 1 + near], [last, last - 2 * n + near, last - 2 * n + k]]
        for row in range(n - 2):
            a, b = 1 + row * 2 * n, 1 + (row + 1) * 2 * n
            faces += [[a + k, b + k, b + near], [a + k, b + near, a + near]]
    return Mesh(vertices, np.array(faces))


def test_few_triangles_are_left_as_they_are() -> None:
    given = box(0.1, 0.2, 0.3)
    assert len(light(body([given]), 12).faces) == 12


def test_many_triangles_become_few_of_nearly_the_same_shape() -> None:
    full = ball(24)
    assert len(full.faces) == 4 * 24 * 23
    for given in (body([full]), Body(full.vertices, full.faces, None, 0)):
        few = light(given, 500)
        assert 100 < len(few.faces) <= 500
        radius = np.linalg.norm(few.vertices, axis=1)
        assert radius.min() > 0.045 and radius.max() < 0.0501
        # The faces are still wound outwards.
        a, b, c = few.vertices[few.faces].transpose(1, 0, 2)
        assert np.einsum("ij,ij->i", np.cross(a, b), c).sum() / 6 == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=0.1)


def test_merging_draws_near_vertices_to_their_mean() -> None:
    mesh = Mesh(np.array([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [1.5, 0.1, 0.1], [0.1, 1.5, 0.1]]),
                np.array([[0, 2, 3], [1, 2, 3], [0, 1, 2]]))
    out = merged(mesh, 1.0)
    # The first two vertices share a cube; the triangle with both of them is removed.
    assert np.array(sorted(out.vertices.tolist())) == pytest.approx(
        np.array([[0.1, 1.5, 0.1], [0.2, 0.1, 0.1], [1.5, 0.1, 0.1]])
    )
    assert len(out.faces) == 2


@pytest.fixture(scope="module")
def hand() -> HandModel:
    return free_hand()


def test_every_part_of_the_free_hand_has_a_light_mesh_in_its_frame(hand: HandModel) -> None:
    parts = hand_meshes(hand)
    assert len(parts) == N_PARTS and all(0 < len(part.faces) <= PART_FACES for part in parts)
    # A finger part begins near its joint and is a few cm long.
    for part in parts[1:]:
        assert np.linalg.norm(part.vertices, axis=1).max() < 0.09
        assert np.linalg.norm(part.vertices, axis=1).min() < 0.03


def test_the_hands_shapes_are_what_collides(hand: HandModel) -> None:
    parts = hand_shapes(hand)
    # The free hand is a box and 15 capsules: 12 triangles, and 8 x 16 + 2 x 16.
    assert [len(part.faces) for part in parts] == [12] + [160] * 15
    (capsule,) = hand.urdf.links[int(hand.part_links[1])].shapes
    radius, length = capsule.size
    apart = np.linalg.norm(parts[1].vertices - np.array(capsule.position), axis=1)
    assert apart.max() == pytest.approx(length / 2 + radius, rel=0.05)


def test_shapes_of_an_object_stay_apart(hand: HandModel) -> None:
    # Two boxes that overlap. Their union would have other corners.
    shapes = (Shape("box", (0.1, 0.1, 0.1)), Shape("box", (0.1, 0.1, 0.1), position=(0.05, 0.05, 0.05)))
    model = object_model("two", shapes, 0.1, False)
    mesh = object_shapes(model)
    assert len(mesh.vertices) == 16 and len(mesh.faces) == 24 and mesh.faces[12:].min() == 8
    assert mesh.vertices.min() == pytest.approx(-0.05) and mesh.vertices.max() == pytest.approx(0.10)
    drawn = scene_meshes(hand, model)
    collision = drawn.colliding()
    assert collision.object.faces.tolist() == mesh.faces.tolist()
    assert [len(part.faces) for part in collision.hand] == [12] + [160] * 15
    assert len(drawn.hand[1].faces) != 160 and collision.bodies == drawn.bodies


def test_a_hull_of_many_triangles_is_drawn_with_few(tmp_path: Path) -> None:
    full = ball(40)
    file = tmp_path / "ball.obj"
    file.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in full.vertices.tolist())
                    + "".join(f"f {a} {b} {c}\n" for a, b, c in (full.faces + 1).tolist()))
    mesh = object_shapes(object_model("ball", (Shape("hull", file=file),), 0.1, False))
    assert len(full.faces) == 4 * 40 * 39 and 1000 < len(mesh.faces) <= OBJECT_FACES
    assert np.linalg.norm(mesh.vertices, axis=1) == pytest.approx(0.05, abs=1e-3)


def test_body_poses_are_the_parts_and_the_object() -> None:
    record = episode()
    q, t = body_poses(meshes(), record)
    R, places = meshes().chain.part_frames(record.T_WH[:, :3, :3], record.T_WH[:, :3, 3], record.gc[:, 6:])
    assert t[:, :16] == pytest.approx(places) and t[:, 16] == pytest.approx(record.T_WO[:, :3, 3])
    assert matrix_from_quaternion(q[:, :16]) == pytest.approx(R, abs=1e-9)
    assert matrix_from_quaternion(q[:, 16]) == pytest.approx(record.T_WO[:, :3, :3], abs=1e-9)


def test_quaternions_follow_each_other_past_half_a_turn() -> None:
    R: Array = np.stack([matrix_from_euler(np.array([0.0, 0.0, angle])) for angle in np.arange(0.0, 12.0, 0.5)])
    q = blendable(R[:, None])[:, 0]
    # Neighbours are half a radian apart, so their quaternions have the cosine of a quarter.
    assert (q[1:] * q[:-1]).sum(axis=1) == pytest.approx(np.cos(0.25))


def test_broken_steps_repeat_the_last_whole_one() -> None:
    record = episode()
    record.T_WH = record.T_WH.copy()
    record.T_WH[5:, 0, 3] = np.nan
    q, t = body_poses(meshes(), record)
    assert np.isfinite(t).all() and np.array_equal(t[7], t[4]) and np.array_equal(q[6], q[4])


def test_the_table_and_the_camera() -> None:
    record = episode()
    assert table_tops(record, 0.5, 0.25).tolist() == [0.5] * 3 + [0.25] * (STEPS - 3)
    moved = replace(record, T_WG=standing(np.eye(4), STEPS))
    assert table_tops(moved, 0.5, 0.25).tolist() == [0.5] * STEPS
    # An episode that begins in the label's pose has no table.
    assert table_tops(replace(moved, window_start=0), 0.5, 0.25).tolist() == [0.25] * STEPS
    target, yaw, distance = viewpoint(record)
    # At step 2: 0.65 of the object (0.5, 0, 0.58), 0.35 of the wrist (0.5, 0.1, 0.7), and 5 cm lower.
    assert target == pytest.approx([0.5, 0.035, 0.65 * 0.58 + 0.35 * 0.7 - 0.05])
    assert distance == 0.7 and np.linalg.norm(viewpoint(record).eye - target) == pytest.approx(0.7)
    # Wrist and object start within x 0.5, y 0 to 0.1, z 0.58 to 0.7 and have a target at (0.9, 0, 0.88).
    there = np.eye(4)
    there[:3, 3] = [0.9, 0.0, 0.88]
    moving = viewpoint(replace(record, T_WG=standing(there, STEPS)))
    assert moving.target == pytest.approx([0.7, 0.05, 0.73])
    # Half of the way's diagonal and 12 cm fill half of the field of view of 40 degrees.
    reach = np.linalg.norm([0.4, 0.1, 0.3]) / 2.0 + 0.12
    assert moving.distance == pytest.approx(reach / np.sin(np.deg2rad(20.0)))
    # The palm faces -y of the wrist; the camera is on its side.
    palm = -record.T_WH[2, :2, 1]
    assert np.array([np.cos(yaw), np.sin(yaw)]) @ palm > 0.0
