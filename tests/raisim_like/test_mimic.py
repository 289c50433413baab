"""Joints that follow others: what is read from a URDF, and how both engines tie them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dgrasp.types import Array
from raisim_like import ArticulatedSystem, Shape, UrdfError, UrdfModel, World, read_urdf
from raisim_like.mimic import Mimic
from tests.hand.three_fingers import write_tied_fingers
from tests.raisim_like.urdfs import write_chain

DT, G = 0.00222, 9.81
KP, KD = 50.0, 0.2
M, B = 1.5, 0.1
"""Multiplier and offset of the tied joints."""
TOLERANCE = {"pybullet": 1e-6, "mujoco": 1e-5}
"""rad or m. Error of a tied joint under the loads below."""


def write_finger(path: Path, mimic: str = f'joint="joint0" multiplier="{M}" offset="{B}"', **more: float) -> Path:
    """A chain of two joints, of which the second mimics."""
    write_chain(path, 2, mass=0.05, length=0.1, **more)  # type: ignore[arg-type]
    text = path.read_text("utf-8").replace('<child link="link1"/>', f'<child link="link1"/><mimic {mimic}/>')
    path.write_text(text, encoding="utf-8")
    return path


def sliders(path: Path, mimics: dict[int, str], limits: dict[int, str] | None = None) -> UrdfModel:
    """Four sliders j0 to j3 of 1 kg each, side by side, and a fixed joint."""
    lines = ['<robot name="r"><link name="base"/>']
    for i in range(4):
        limit = (limits or {}).get(i, 'lower="-1" upper="1"')
        lines.append(
            f'<link name="l{i}"><inertial><mass value="1"/></inertial></link><joint name="j{i}" type="prismatic">'
            f'<axis xyz="0 0 1"/><limit {limit}/><parent link="base"/><child link="l{i}"/>'
            f'{f"<mimic {mimics[i]}/>" if i in mimics else ""}</joint>'
        )
    lines.append('<link name="end"/><joint name="held" type="fixed"><parent link="l0"/><child link="end"/></joint>')
    path.write_text("".join([*lines, "</robot>"]), encoding="utf-8")
    return read_urdf(path)


@pytest.fixture(params=["faithful", "fast"])
def world(engine: str, request: pytest.FixtureRequest) -> Iterator[World]:
    made = World(engine, DT, request.param)
    made.set_gravity((0, 0, 0))
    yield made
    made.close()


def add(world: World, urdf: Path | UrdfModel) -> ArticulatedSystem:
    system = world.add_articulated_system(urdf)
    system.set_pd_gains(KP, KD)
    return system


def error(system: ArticulatedSystem) -> float:
    q = system.generalized_coordinate
    return float(np.abs(q - system.model.ties.coordinates(q)).max())


def worst_error(world: World, system: ArticulatedSystem, control_steps: int) -> float:
    """The largest error after each of some control steps."""
    worst = 0.0
    for _ in range(control_steps):
        world.integrate(13)
        worst = max(worst, error(system))
    return worst


# Reading -----------------------------------------------------------------------------------------


def test_a_joint_without_multiplier_and_offset_does_the_same_as_its_leader(tmp_path: Path) -> None:
    model = sliders(tmp_path / "r.urdf", {1: 'joint="j0"'})
    assert [link.mimic for link in model.links] == [None, Mimic(0, 1.0, 0.0), None, None]
    assert model.dof == 4 and model.ties.followers.tolist() == [1] and model.ties.free.tolist() == [0, 2, 3]


def test_joints_that_follow_followers_follow_the_first(tmp_path: Path) -> None:
    """j3 = -2 j1 + 0.3 and j1 = 0.5 j2 - 0.1 give j3 = -j2 + 0.5; a leader may come later in the file."""
    model = sliders(tmp_path / "r.urdf", {
        3: 'joint="j1" multiplier="-2" offset="0.3"', 1: 'joint="j2" multiplier="0.5" offset="-0.1"',
    })  # fmt: skip
    assert [link.mimic for link in model.links] == [None, Mimic(2, 0.5, -0.1), None, Mimic(2, -1.0, 0.5)]
    q = np.array([[0.1, 9.0, 0.2, 9.0], [0.0, 9.0, -0.4, 9.0]])
    assert model.ties.coordinates(q) == pytest.approx(np.array([[0.1, 0.0, 0.2, 0.3], [0.0, -0.3, -0.4, 0.9]]))
    assert model.ties.velocities(q[0]) == pytest.approx(np.array([0.1, 0.1, 0.2, -0.2]))


def test_limits_of_leader_and_followers_agree(tmp_path: Path) -> None:
    """j1 = -2 j0 + 0.1 within -0.5 to 0.3 needs j0 between -0.1 and 0.3; j2 = j0 without limits needs nothing."""
    model = sliders(
        tmp_path / "r.urdf", {1: 'joint="j0" multiplier="-2" offset="0.1"', 2: 'joint="j0"'},
        {0: 'lower="-1" upper="0.2"', 1: 'lower="-0.5" upper="0.3"', 2: 'lower="-9" upper="9"'},
    )
    assert model.joint_limits == pytest.approx(np.array([[-0.1, 0.2], [-0.3, 0.3], [-0.1, 0.2], [-1.0, 1.0]]))


BAD = {
    'joint="nowhere"': r"joint 'j1' mimic: joint 'nowhere' is not in the file; expected the name of a joint that moves",
    'multiplier="2"': r"joint 'j1' mimic: joint None is not in the file",
    'joint="held"': r"joint 'j1' mimic: joint 'held' is fixed; expected",
    'joint="j1"': r"joint 'j1' mimic: it follows itself \(j1 -> j1\); remove one <mimic> of these",
    'joint="j2"': r"joint 'j1' mimic: it follows itself \(j1 -> j2 -> j3 -> j1\)",
    'joint="j0" multiplier="0"': r"joint 'j1' mimic: multiplier 0 would keep the joint still; make it a fixed joint",
    'joint="j0" multiplier="two"': r"joint 'j1' mimic multiplier: expected 1 numbers, got 'two'",
    'joint="j0" offset="nan"': r"joint 'j1' mimic offset: expected 1 numbers, got 'nan'",
    'joint="j0" offset="2.5"': r"joint 'j1' mimic: its limits -1 to 1 need joint 'j0' between -3.5 and -1.5, whose "
                               r"limits are -1 to 1; change the limits, the multiplier or the offset",
}  # fmt: skip


@pytest.mark.parametrize("mimic", BAD)
def test_bad_mimics_are_refused(tmp_path: Path, mimic: str) -> None:
    others = {2: 'joint="j3"', 3: 'joint="j1"'} if mimic == 'joint="j2"' else {}
    with pytest.raises(UrdfError, match=rf"^{re.escape(str(tmp_path))}.*r\.urdf: {BAD[mimic]}"):
        sliders(tmp_path / "r.urdf", {1: mimic, **others})


def test_a_fixed_joint_s_mimic_means_nothing(tmp_path: Path) -> None:
    path = write_finger(tmp_path / "arm.urdf")
    path.write_text(path.read_text("utf-8").replace('name="joint1" type="revolute"', 'name="joint1" type="fixed"'))
    assert [link.mimic for link in read_urdf(path).links] == [None]


# Motion ------------------------------------------------------------------------------------------


def test_tied_sliders_move_as_one_body(world: World, tmp_path: Path) -> None:
    """With j1 = M j0 + B, the implicit law holds for the mass 1 + M^2, one motor, and a force f0 + M f1."""
    system = add(world, sliders(tmp_path / "r.urdf", {1: f'joint="j0" multiplier="{M}" offset="{B}"'}))
    system.set_state(np.zeros(4))
    assert system.generalized_coordinate.tolist() == [0.0, B, 0.0, 0.0]
    system.set_pd_target([0.2, -9.0, 0.0, 0.0])
    system.set_generalized_force([1.0, -3.0, 0.0, 0.0])
    mass, force = 1.0 + M**2, 1.0 - 3.0 * M
    q = v = 0.0
    for _ in range(30):
        world.integrate(1)
        v = (mass * v + DT * (KP * (0.2 - q) + force)) / (mass + DT * KD + DT**2 * KP)
        q += DT * v
        assert system.generalized_coordinate[0] == pytest.approx(q, abs=2e-6)
        assert error(system) < TOLERANCE[world.engine.name]


def test_gains_targets_and_coordinates_of_followers_have_no_effect(world: World, tmp_path: Path) -> None:
    system = add(world, write_finger(tmp_path / "arm.urdf"))
    runs = []
    for other in (0.0, 0.7):
        world.engine_world.forget_contacts()
        system.set_base_pose((0, 0, 0))
        system.set_pd_gains([KP, KP * other], [KD, other])
        system.set_state([0.2, other], [0.5, other])
        assert system.generalized_coordinate == pytest.approx([0.2, 0.2 * M + B])
        assert system.generalized_velocity == pytest.approx([0.5, 0.5 * M])
        system.set_pd_target([0.5, other])
        world.integrate(40)
        runs.append(system.generalized_coordinate.tolist())
    assert runs[0] == runs[1] and runs[0][0] > 0.3


def test_gravity_on_the_outer_link_is_felt_at_the_leader(world: World, tmp_path: Path) -> None:
    """At rest, kp (q0 - q0*) = tau_0 + M tau_1 with gravity's moments about both joints."""
    world.set_gravity((0, 0, -G))
    system = add(world, write_finger(tmp_path / "arm.urdf"))
    system.set_pd_target([0.3, 0.0])
    worst = worst_error(world, system, 60)
    q0, q1 = system.generalized_coordinate
    outer = 0.05 * G * 0.1 * np.cos(q0 + q1)
    assert KP * (q0 - 0.3) == pytest.approx(2.0 * 0.05 * G * 0.1 * np.cos(q0) + (1.0 + M) * outer, abs=1e-4)
    assert worst < TOLERANCE[world.engine.name]


def test_a_torque_on_the_follower_deflects_the_leader(world: World, tmp_path: Path) -> None:
    system = add(world, write_finger(tmp_path / "arm.urdf"))
    system.set_generalized_force([0.0, 2.0])
    world.integrate(1300)
    assert system.generalized_coordinate == pytest.approx([M * 2.0 / KP, M * M * 2.0 / KP + B], abs=1e-5)


def test_a_wall_stops_both_joints_against_the_leader_s_motor(world: World, tmp_path: Path) -> None:
    system = add(world, write_finger(tmp_path / "arm.urdf", tip_radius=0.02))
    wall = world.add_body([Shape("box", (0.2, 0.2, 0.2))], 0.0, np.eye(3))
    wall.set_state((0.1, 0, -0.22))
    system.set_pd_target([0.5, 0.0])
    worst = worst_error(world, system, 30)
    q0, _ = system.generalized_coordinate
    contacts = system.contacts()
    assert q0 < 0.4 and {c.link_a for c in contacts} == {1} and worst < TOLERANCE[world.engine.name]
    _, elbow = system.frame_pose("link1")
    # PyBullet's forces on the finger act on its own surface, MuJoCo's halfway between the two.
    share = 1.0 if world.engine.name == "pybullet" else 0.5

    def moment(about: Array) -> float:
        return sum(
            float(np.cross(c.point_W - share * c.depth * c.normal_W - about,
                           c.impulse * c.normal_W + c.tangential_impulse_W)[1]) for c in contacts
        ) / DT  # fmt: skip

    assert moment(np.zeros(3)) + M * moment(elbow) == pytest.approx(-KP * (0.5 - q0), abs=1e-3)


def test_limits_stop_both_joints(world: World, tmp_path: Path) -> None:
    """The outer joint's limit of 0.55 stops the inner one at 0.3, within one step, and nothing throws them back.

    Bullet's solver ends before tie and stop agree.
    """
    system = add(world, write_finger(tmp_path / "arm.urdf", limit=0.55))
    assert system.joint_limits == pytest.approx(np.array([[-0.65 / M, 0.3], [-0.55, 0.55]]))
    system.set_pd_target([0.4, 0.0])
    worst = 0.0
    for _ in range(20):
        world.integrate(13)
        worst = max(worst, error(system))
    stopped = system.generalized_coordinate
    assert 0.3 <= stopped[0] < 0.35 and worst < 1e-3
    world.integrate(130)
    assert system.generalized_coordinate == pytest.approx(stopped, abs=1e-3)


def test_a_shaken_hand_that_holds_a_box_keeps_its_ties(world: World, tmp_path: Path) -> None:
    """Bullet's solver ends before nine contacts and three ties agree; a tie makes up for it in the next step."""
    hand = world.add_articulated_system(write_tied_fingers(tmp_path / "three.urdf"), enforce_limits=False)
    kp, target = np.full(hand.dof, KP), np.zeros(hand.dof)
    kp[:3], target[6:] = 500.0, [1.2, 0.0, 0.0, 1.2, 0.0, 1.2]
    hand.set_pd_gains(kp, KD)
    box = world.add_box(0.05, 0.03, 0.12, 0.2)
    box.set_state((-0.055, -0.045, 0.0))
    rng, worst = np.random.default_rng(0), 0.0
    for _ in range(60):
        target[:6] = [0.02, 0.02, 0.02, 0.1, 0.1, 0.1] * rng.normal(size=6)
        hand.set_pd_target(target)
        world.integrate(13)
        worst = max(worst, error(hand))
    assert hand.contacts() and worst < (2e-3 if world.engine.name == "pybullet" else 1e-5)


def test_ties_outlive_snapshots_and_other_bodies(world: World, tmp_path: Path) -> None:
    world.set_gravity((0, 0, -G))
    system, ball = add(world, write_finger(tmp_path / "arm.urdf")), world.add_sphere(0.05, 1.0)
    system.set_pd_target([0.4, 0.0])
    world.integrate(5)
    snapshot = world.save()
    runs = []
    for _ in range(2):
        world.restore(snapshot)
        world.integrate(20)
        runs.append(system.generalized_coordinate.tolist())
    assert runs[0] == runs[1]
    other = add(world, write_finger(tmp_path / "other.urdf"))
    other.set_base_pose((0, 3, 0))
    world.remove(system)
    world.remove(ball)
    other.set_pd_target([0.4, 0.0])
    world.integrate(20)
    assert error(other) < TOLERANCE[world.engine.name] and other.generalized_coordinate[0] > 0.2


def test_a_block_slides_as_usual_beside_a_tied_system(world: World, tmp_path: Path) -> None:
    """It loses friction * g * t."""
    world.set_gravity((0, 0, -G))
    world.set_default_material(0.5)
    add(world, write_finger(tmp_path / "arm.urdf")).set_base_pose((0, 0, 2))
    world.add_ground()
    block = world.add_box(0.3, 0.3, 0.06, 1.0)
    block.set_state((0, 5, 0.03), linear=(1.5, 0, 0))
    world.integrate(65)
    assert 1.5 - block.linear_velocity[0] == pytest.approx(0.5 * G * 65 * DT, rel=0.02)
