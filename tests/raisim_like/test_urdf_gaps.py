"""URDFs of others: scaled meshes, links without masses."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from dgrasp.files.paths import data_root
from dgrasp.geometry.inertia import shape_properties
from dgrasp.types import Array
from raisim_like.shape_inertia import shape_inertia
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel, read_urdf
from raisim_like.world import World

INERTIAL = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'


def corners(x: float, y: float, z: float) -> Array:
    """(8, 3): of a box with these full lengths about the origin."""
    return np.array(list(itertools.product((-x / 2, x / 2), (-y / 2, y / 2), (-z / 2, z / 2))))


def write_obj(path: Path, points: Array) -> Path:
    """A file of a convex hull's vertices, with the faces that engines ask for."""
    quads = [[1, 2, 4, 3], [5, 7, 8, 6], [1, 5, 6, 2], [3, 4, 8, 7], [1, 3, 7, 5], [2, 6, 8, 4]]
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in points)
                    + "".join(f"f {a} {b} {c}\nf {a} {c} {d}\n" for a, b, c, d in quads))
    return path


def robot(tmp_path: Path, links: list[str]) -> UrdfModel:
    """A chain of sliders along z; links: what each holds."""
    lines = ['<robot name="r"><link name="base"/>']
    for i, content in enumerate(links):
        lines.append(f'<link name="l{i}">{content}</link><joint name="j{i}" type="prismatic"><axis xyz="0 0 1"/>'
                     f'<limit lower="-1" upper="1"/><parent link="{f"l{i - 1}" if i else "base"}"/>'
                     f'<child link="l{i}"/></joint>')
    (tmp_path / "robot.urdf").write_text("".join([*lines, "</robot>"]))
    return read_urdf(tmp_path / "robot.urdf")


def collision(geometry: str, origin: str = "") -> str:
    return f"<collision>{origin}<geometry>{geometry}</geometry></collision>"


@pytest.mark.parametrize(
    "shape",
    [Shape("box", (0.1, 0.2, 0.3)), Shape("sphere", (0.1,)), Shape("cylinder", (0.1, 0.4)),
     Shape("capsule", (0.1, 0.4)), Shape("box", (0.1, 0.2, 0.3), (1.0, 2.0, 3.0), (0.5, 0.5, -0.5, 0.5))],
)
def test_masses_of_shapes(shape: Shape) -> None:
    # At 1 kg/m3 there, at 1000 kg/m3 here.
    mass, center, inertia = shape_inertia(shape)
    known = shape_properties(shape)
    np.testing.assert_allclose(mass, 1000 * known.volume, rtol=1e-12)
    np.testing.assert_allclose(center, known.center_of_mass, atol=1e-15)
    np.testing.assert_allclose(inertia, 1000 * known.inertia, atol=1e-12)


def test_the_mass_of_a_scaled_hull_by_hand(tmp_path: Path) -> None:
    file = write_obj(tmp_path / "part.obj", corners(1.0, 2.0, 3.0) + np.array([5.0, 0.0, 0.0]))
    for y in (0.2, -0.2):
        mass, center, inertia = shape_inertia(Shape("hull", file=file, scale=(0.1, y, 0.1)))
        # A box of 0.1 x 0.4 x 0.3 m at x = 0.5: 12 kg; 12 / 12 (y^2 + z^2) and so on.
        np.testing.assert_allclose(mass, 12.0, rtol=1e-12)
        np.testing.assert_allclose(center, [0.5, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(inertia, np.diag([0.25, 0.10, 0.17]), atol=1e-12)


def test_links_without_inertial(tmp_path: Path) -> None:
    box = collision('<box size="0.1 0.2 0.3"/>', '<origin xyz="0 0 0.5"/>')
    with pytest.warns(UserWarning, match=r"no <inertial> with a mass in l0, l2; taken from the .* at 1000 kg/m3"):
        model = robot(tmp_path, [box, INERTIAL + box, box + box])
    # 0.1 x 0.2 x 0.3 m are 6 kg; two boxes at one place count twice.
    assert [link.mass for link in model.links] == pytest.approx([6.0, 2.0, 12.0])
    np.testing.assert_allclose(model.links[0].com, [0.0, 0.0, 0.5])
    np.testing.assert_allclose(model.links[0].inertia, np.diag([0.065, 0.05, 0.025]), atol=1e-12)


def test_the_free_hand_without_inertial(tmp_path: Path, engine: str) -> None:
    file = data_root() / "free" / "hand" / "free_hand.urdf"
    stated = read_urdf(file)
    (tmp_path / "hand.urdf").write_text(re.sub(r"<inertial>.*?</inertial>", "", file.read_text(), flags=re.DOTALL))
    with pytest.warns(UserWarning, match=r"no <inertial> with a mass in palm, index_proximal, .*, thumb_distal;"):
        system = World(engine).add_articulated_system(tmp_path / "hand.urdf")
    # Its shapes approximate its parts, whose density is that of water: 306 g in place of 337 g.
    for link, known in zip(system.model.links, stated.links, strict=True):
        assert link.mass == pytest.approx(known.mass, rel=0.25) and (link.mass > 0.0) == link.inertia.any()
    assert system.model.mass == pytest.approx(0.306, abs=1e-3)


def test_a_stated_mass_of_zero_is_none(tmp_path: Path) -> None:
    box = collision('<box size="0.1 0.2 0.3"/>')
    zero = INERTIAL.replace('"2"', '"0"')
    # The slider before, which states nothing but zeros, carries nothing.
    with pytest.warns(UserWarning, match=r"no <inertial> with a mass in l1, l2;"):
        model = robot(tmp_path, [zero, box, zero + box])
    assert [link.mass for link in model.links] == pytest.approx([0.0, 6.0, 6.0])


def test_masses_on_the_links_before_are_left_there(tmp_path: Path) -> None:
    box = collision('<box size="0.1 0.2 0.3"/>')
    model = robot(tmp_path, [INERTIAL, "", box])
    assert [link.mass for link in model.links] == [2.0, 0.0, 0.0]
    assert robot(tmp_path, ["", INERTIAL + box]).mass == 2.0


def test_meshes_of_which_no_mass_is_known(tmp_path: Path) -> None:
    (tmp_path / "part.stl").write_bytes(b"")
    with pytest.warns(UserWarning, match=r"no <inertial> in l0 \(.*part\.stl: no \.obj file"):
        assert robot(tmp_path, [collision('<mesh filename="part.stl"/>')]).mass == 0.0


def test_scaled_meshes_collide_at_their_scale(tmp_path: Path, engine: str) -> None:
    write_obj(tmp_path / "part.obj", corners(1.0, 1.0, 1.0))
    text = collision('<mesh filename="part.obj" scale="0.1 0.1 0.04"/>') + collision(
        '<mesh filename="part.obj" scale="0.02 0.02 0.1"/>')
    model = robot(tmp_path, [INERTIAL + text])
    assert [shape.scale for shape in model.links[0].shapes] == [(0.1, 0.1, 0.04), (0.02, 0.02, 0.1)]
    world = World(engine)
    system = world.add_articulated_system(tmp_path / "robot.urdf")
    ball = world.add_sphere(0.01, 0.1)
    # The plate's top is at 0.02 m, the pin's at 0.05 m: the ball touches within a radius of 0.01 m of these.
    for x, z, touches in ((0.04, 0.0285, True), (0.04, 0.04, False), (0.0, 0.0585, True), (0.0, 0.07, False)):
        ball.set_state([x, 0.0, z])
        system.set_state(np.zeros(1))
        world.integrate()
        assert bool(system.contacts()) == touches, (x, z)
