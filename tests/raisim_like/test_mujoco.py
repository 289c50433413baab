"""What only MuJoCo has: control inside the model, a model that is recompiled, its own contact law and materials."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dgrasp.hand.free.hand import URDF_PATH
from raisim_like import EngineError, Shape, World, read_urdf
from raisim_like.engines import default_engine, make_engine
from raisim_like.engines.floors import LIGHT_INERTIA
from raisim_like.world import BODY, STATIC, SYSTEM, collision_mask
from tests.raisim_like.urdfs import mass_matrix, write_chain

pytest.importorskip("mujoco")

DT, G = 0.00222, 9.81


@pytest.fixture
def world() -> Iterator[World]:
    made = World("mujoco", DT)
    yield made
    made.close()


def test_one_joint_is_the_implicit_law_exactly(world: World, tmp_path: Path) -> None:
    """(J + dt D + dt^2 K) v+ = J v + dt (K (q* - q) + ff), also after the gains changed."""
    world.set_gravity((0, 0, 0))
    system = world.add_articulated_system(write_chain(tmp_path / "arm.urdf"))
    system.set_pd_target([0.7])
    system.set_generalized_force([4.0])
    J = 0.3 * 0.2**2 + LIGHT_INERTIA
    q = v = 0.0
    for kp, kd in ((50.0, 0.2), (500.0, 3.0), (5.0, 0.0)):
        system.set_pd_gains(kp, kd)
        for _ in range(40):
            D = kd + 0.5
            v = (J * v + DT * (kp * (0.7 - q) + 4.0)) / (J + DT * D + DT**2 * kp)
            q += DT * v
            world.integrate(1)
            assert system.generalized_velocity[0] == pytest.approx(v, abs=1e-12)
            assert system.generalized_coordinate[0] == pytest.approx(q, abs=1e-12)
    assert abs(q - 0.7) > 0.02


def test_with_the_fast_preset_a_joint_is_the_implicit_law_of_longer_steps(tmp_path: Path) -> None:
    """13 timesteps are 7 engine steps, and one timestep is one."""
    world = World("mujoco", DT, "fast")
    world.set_gravity((0, 0, 0))
    system = world.add_articulated_system(write_chain(tmp_path / "arm.urdf"))
    system.set_pd_target([0.7])
    system.set_pd_gains(50.0, 0.2)
    J, D = 0.3 * 0.2**2 + LIGHT_INERTIA, 0.2 + 0.5
    q = v = 0.0
    for timesteps, steps in ((13, 7), (1, 1), (13, 7), (4, 2)):
        h = DT * timesteps / steps
        for _ in range(steps):
            v = (J * v + h * 50.0 * (0.7 - q)) / (J + h * D + h**2 * 50.0)
            q += h * v
        world.integrate(timesteps)
        assert system.generalized_velocity[0] == pytest.approx(v, abs=1e-12)
        assert system.generalized_coordinate[0] == pytest.approx(q, abs=1e-12)
    world.close()


def test_the_fast_preset_keeps_impulses_those_of_a_timestep() -> None:
    """This holds for contacts as they are read and for external forces."""
    world = World("mujoco", DT, "fast")
    world.add_ground()
    box, pushed = world.add_box(0.1, 0.1, 0.1, 2.0), world.add_box(0.1, 0.1, 0.1, 0.5)
    box.set_state((0, 0, 0.05))
    pushed.set_state((1, 0, 9.0))
    world.integrate(13 * 20)
    assert sum(contact.impulse for contact in box.contacts()) == pytest.approx(2.0 * G * DT, rel=1e-3)
    world.set_gravity((0, 0, 0))
    pushed.set_external_force((0, 3.0, 0))
    world.integrate(13)
    assert pushed.linear_velocity[1] == pytest.approx(3.0 * DT / 0.5, rel=1e-9)
    world.close()


def test_the_mass_matrix_is_the_links_alone(world: World) -> None:
    """The gains make no difference. Links lighter than those of the light hand get its inertia."""
    system = world.add_articulated_system(URDF_PATH)
    system.set_base_pose((1, 2, 3), (np.sqrt(0.5), 0, np.sqrt(0.5), 0))
    q = np.random.default_rng(1).uniform(-0.5, 0.5, system.dof)
    system.set_state(q)
    plain = system.mass_matrix()
    system.set_pd_gains(500.0, 2.0)
    assert np.abs(system.mass_matrix() - plain).max() < 1e-12
    light = mass_matrix(system.model, q, np.full(system.dof, LIGHT_INERTIA))
    largest = max(np.linalg.eigvalsh(link.inertia)[2] for link in system.model.links)
    assert np.linalg.eigvalsh(plain - light).min() > -1e-12
    assert np.abs(plain - light).max() < 20 * largest


def test_states_gains_and_targets_outlive_bodies_that_come_and_go(world: World, tmp_path: Path) -> None:
    first = world.add_sphere(0.05, 1.0)
    arm = world.add_articulated_system(write_chain(tmp_path / "arm.urdf", 2))
    wall = world.add_body([Shape("box", (0.1, 0.1, 0.1))], 0.0, np.eye(3))
    wall.set_state((0, 3, 0))
    arm.set_base_pose((0, 0, 2))
    arm.set_pd_gains(50, 0.2)
    arm.set_pd_target([0.3, -0.2])
    first.set_state((0, 5, 0), (0.6, 0.8, 0, 0), (1, 0, 0), (0, 2, 0))
    world.integrate(5)
    states = first.state, wall.state, arm.generalized_coordinate, arm.generalized_velocity, *arm.frame_pose("link1")
    world.remove(world.add_box(0.1, 0.1, 0.1, 1.0))
    second = world.add_sphere(0.05, 1.0)
    second.set_state((0, -5, 0))
    now = first.state, wall.state, arm.generalized_coordinate, arm.generalized_velocity, *arm.frame_pose("link1")
    assert all(np.array_equal(a, b) for a, b in zip(states, now, strict=True))
    world.integrate(600)
    # It is still where target and weight balance: kp (q* - q) is gravity's moment.
    assert np.abs(arm.generalized_coordinate - [0.3, -0.2]).max() < 0.1


def test_what_is_placed_anew_has_no_past(world: World) -> None:
    """A hand that closes on a ball does the same to the bit, whatever happened before."""
    hand = world.add_articulated_system(URDF_PATH)
    ball = world.add_sphere(0.035, 0.1)
    world.add_ground()
    target = np.zeros(51)
    target[8::3] = 0.9

    def episode(seed: int) -> list[float]:
        rng = np.random.default_rng(seed)
        world.engine_world.forget_contacts()
        assert hand.contacts() == [] == ball.contacts()
        hand.set_base_pose((0, 0, 0.06))
        hand.set_state(np.zeros(51))
        hand.set_pd_gains(50, 0.2)
        hand.set_pd_target(target * rng.uniform(0.5, 1.0))
        ball.set_state((-0.09, 0.01, 0.036))
        world.integrate(150)
        assert hand.contacts() and ball.contacts()
        hand.set_pd_gains(500, 0.2)
        world.integrate(50)
        return [*hand.generalized_coordinate, *hand.generalized_velocity, *ball.state]

    first = episode(0)
    assert episode(1) != first
    assert episode(0) == first


@pytest.mark.parametrize("speed", [0.05, 1.5])
def test_a_sliding_block_stays_on_the_ground(world: World, speed: float) -> None:
    """MuJoCo's own law throws it up by friction times its speed; here its weight presses it down throughout."""
    world.set_default_material(0.5)
    ground, block = world.add_ground(), world.add_box(0.3, 0.3, 0.06, 1.0)
    block.set_state((0, 0, 0.03), linear=(speed, 0, 0))
    world.integrate(3)
    while block.linear_velocity[0] > 0.02:
        world.integrate(1)
        found = [c for c in block.contacts() if c.body_b == ground.id]
        assert sum(c.impulse for c in found) == pytest.approx(G * DT, rel=0.03)
        assert sum(c.tangential_impulse_W for c in found)[0] == pytest.approx(-0.5 * G * DT, rel=0.03)
    # The cost of the law: the block sinks in by friction * timestep * speed.
    assert 0.03 - block.position[2] == pytest.approx(0.5 * DT * speed, abs=1e-4)


def test_any_table_of_materials_is_exact(world: World) -> None:
    """PyBullet cannot have all of these pairs: a with a and b with b are slippery, a with b is not."""
    for first, second, friction in (("a", "a", 0.1), ("b", "b", 0.1), ("a", "b", 0.7)):
        world.set_material_pair(first, second, friction)
    ground = world.add_ground(material="a")
    # A wall inside the ground, with a friction of its own: neither can move, so they make no contact.
    world.add_body([Shape("box", (0.1, 0.1, 0.1))], 0.0, np.eye(3), material="b").set_state((5, 5, 0))
    blocks = [world.add_box(0.2, 0.2, 0.04, 1.0, material) for material in ("a", "b", "c")]
    for i, block in enumerate(blocks):
        block.set_state((0, i, 0.02), linear=(2, 0, 0))
    world.integrate(60)
    assert {c.body_b for c in ground.contacts()} == {block.id for block in blocks}
    lost = [2.0 - block.linear_velocity[0] for block in blocks]
    assert lost == pytest.approx([friction * G * 60 * DT for friction in (0.1, 0.7, 0.8)], rel=0.02)


def test_a_system_s_friction_with_itself_is_its_own_pair(world: World, tmp_path: Path) -> None:
    """Two balls of one system rub against each other, but not against the links that carry them."""
    world.set_gravity((0, 0, 0))
    path = tmp_path / "pair.urdf"
    link = (
        '<link name="{0}"><inertial><mass value="1"/></inertial><collision><geometry><sphere radius="0.051"/>'
        '</geometry></collision></link><joint name="j{0}" type="prismatic"><parent link="{1}"/><child link="{0}"/>'
        '<origin xyz="{2} 0 0"/><axis xyz="{3}"/><limit lower="-1" upper="1"/></joint>'
    )
    path.write_text(
        '<robot name="pair"><link name="base"/>'
        + link.format("root", "base", 0.05, "1 0 0") + link.format("left", "root", -0.05, "0 1 0")
        + link.format("right", "root", 0.05, "0 1 0") + "</robot>"
    )  # fmt: skip
    world.set_material_pair("rubber", "rubber", 0.4)
    system = world.add_articulated_system(path, "rubber", self_collision=True)
    system.set_state([0, 0, 0], [0, 0.2, 0])
    world.integrate(1)
    found = system.contacts()
    assert {frozenset((c.link_a, c.link_b)) for c in found} == {frozenset((1, 2))}


def test_a_world_that_breaks_leaves_no_file(world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arm = world.add_articulated_system(write_chain(Path("arm.urdf")))
    world.engine_world.set_feed_forward(arm.id, np.full(1, np.nan))
    world.integrate(13)
    assert np.isnan(arm.generalized_coordinate).all()
    assert [path.name for path in tmp_path.iterdir()] == ["arm.urdf"]


def test_an_inertia_that_no_solid_has_is_raised_to_one_that_turns(world: World) -> None:
    """MuJoCo requires each principal moment to be at most the sum of the others; careless files break this."""
    world.set_gravity((0, 0, 0))
    body = world.add_body([Shape("sphere", (0.05,))], 1.0, np.diag([1e-4, 5e-4, 2e-3]))
    body.set_state((0, 0, 0), angular=(0, 0, 3))
    world.integrate(10)
    assert body.angular_velocity == pytest.approx([0, 0, 3], abs=1e-12)


def test_more_masks_than_bits_are_refused(world: World) -> None:
    for i in range(32):
        mask = collision_mask(BODY, (i & 1) * STATIC | (i & 2) * BODY | (i >> 2) << 3)
        world.add_body([Shape("sphere", (0.05,))], 1.0, np.eye(3), mask=mask)
    with pytest.raises(EngineError, match="31 kinds of collision masks, but this world has 32"):
        world.integrate(1)
    assert SYSTEM == 4


def test_a_damaged_mesh_is_refused_by_its_name(world: World, tmp_path: Path) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    world.add_body([Shape("hull", file=tmp_path / "flat.obj")], 1.0, np.eye(3))
    with pytest.raises(EngineError, match="MuJoCo refused a body"):
        world.integrate(1)


def test_without_pybullet_mujoco_is_the_default_and_the_message_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    code = ("import sys; sys.modules['pybullet'] = None; import raisim_like; world = raisim_like.World()\n"
            "world.integrate(1); print(world.engine.name)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "mujoco\n", done.stderr
    monkeypatch.setitem(sys.modules, "pybullet", None)
    assert default_engine() == "mujoco"
    with pytest.raises(EngineError, match=r"needs the package pybullet.*pip install pybullet==3.2.7.* engine mujoco"):
        make_engine("pybullet")


def test_a_model_is_read_once_for_many_worlds() -> None:
    model = read_urdf(URDF_PATH)
    worlds = [World("mujoco", DT) for _ in range(2)]
    hands = [world.add_articulated_system(model) for world in worlds]
    hands[0].set_pd_gains(50.0, 0.2)
    for world in worlds:
        world.integrate(1)
    assert hands[0].generalized_velocity.tolist() != hands[1].generalized_velocity.tolist()
    for world in worlds:
        world.close()
        world.close()
