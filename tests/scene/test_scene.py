"""Hand, object and table in one world: placed, loaded, touched, and without a past."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.config.sections import ActionConfig, PhysicsConfig
from dgrasp.hand.free.hand import URDF_PATH
from dgrasp.hand.load import load_hand
from dgrasp.hand.model import HandModel
from dgrasp.objects.free import free_object
from dgrasp.scene.scene import LOWERED_TOP, TABLE_SIZE, TABLE_TOP, TABLE_XY
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_quaternion, transform
from tests.scenes import OneScene

HEIGHT = 0.175  # of the sugar box
G = 9.81
ASIDE = transform(np.eye(3), np.array([0.4, -0.4, 1.5]))
ON_TABLE = transform(np.eye(3), np.array([1.0, 0.1, TABLE_TOP + HEIGHT / 2]))
FLAT = np.zeros(45)


@pytest.fixture(scope="module")
def hand() -> HandModel:
    return load_hand(URDF_PATH, "free")


def make_scene(hand: HandModel, engine: str, **physics: object) -> OneScene:
    return OneScene(hand, free_object("004_sugar_box", "official", True), PhysicsConfig(**physics), engine)


@pytest.fixture
def scene(hand: HandModel, engine: str) -> Iterator[OneScene]:
    made = make_scene(hand, engine)
    yield made
    made.close()


def hold(scene: OneScene, pose: Array = FLAT) -> None:
    """The PD target is where the hand was placed."""
    scene.set_target(np.concatenate([np.zeros(6), pose]))


def test_what_is_placed_is_read_back_at_rest(scene: OneScene) -> None:
    turn = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
    T_WH, T_WO = transform(turn, np.array([0.4, 0.1, 0.9])), transform(turn.T, np.array([0.9, 0.1, 0.7]))
    pose = np.linspace(-0.2, 0.4, 45)
    scene.place(T_WH, pose, T_WO, TABLE_TOP)
    gc, gv, impulse, body = scene.read()
    assert gc.tolist() == [0.0] * 6 + pose.tolist()
    assert gv.tolist() == [0.0] * 51 and impulse.tolist() == [0.0] * 16
    assert body[:3].tolist() == T_WO[:3, 3].tolist() and body[7:].tolist() == [0.0] * 6
    assert np.abs(matrix_from_quaternion(body[3:7]) - turn.T).max() < 1e-12
    R, t = scene.hand.frame_pose("palm")
    assert np.abs(R - turn).max() < 1e-6 and np.abs(t - T_WH[:3, 3]).max() < 1e-6


def test_the_table_stands_where_the_labels_know_it_and_goes_down(scene: OneScene) -> None:
    scene.place(ASIDE, FLAT, ON_TABLE, TABLE_TOP)
    assert scene.table.position.tolist() == [*TABLE_XY, TABLE_TOP - TABLE_SIZE[2] / 2]
    scene.set_table_top(LOWERED_TOP)
    assert scene.table.position[2] + TABLE_SIZE[2] / 2 == LOWERED_TOP == 0.25


def test_the_object_rests_on_the_table_and_falls_with_it_gone(scene: OneScene) -> None:
    scene.place(ASIDE, FLAT, ON_TABLE, TABLE_TOP)
    hold(scene)
    scene.advance(60)
    assert scene.touches_table()
    assert scene.read()[3][2] == pytest.approx(TABLE_TOP + HEIGHT / 2, abs=1e-3)
    scene.set_table_top(LOWERED_TOP)
    scene.advance(60)
    assert not scene.touches_table()
    t = 60 * scene.world.timestep
    assert scene.read()[3][9] == pytest.approx(-G * t, abs=1e-3)
    scene.advance(60)
    assert scene.touches_table()
    assert scene.read()[3][2] == pytest.approx(LOWERED_TOP + HEIGHT / 2, abs=6e-3)


def test_the_wrist_is_lifted_by_what_it_is_to_carry(scene: OneScene, hand: HandModel) -> None:
    """At rest, kp dz = 10 m/s^2 times the carried mass: an arm has the hand's own weight."""
    assert scene.hand.mass_matrix()[0, 0] == pytest.approx(hand.carried_mass, abs=1e-3)
    at_rest_with_loads(scene, 0.0)


def test_a_hand_without_an_arm_sags_by_its_weight(hand: HandModel, engine: str) -> None:
    scene = make_scene(replace(hand, carried_mass=0.0), engine)
    at_rest_with_loads(scene, hand.urdf.mass)
    scene.close()


def at_rest_with_loads(scene: OneScene, hanging: float) -> None:
    scene.place(ASIDE @ transform(Rotation.from_rotvec([0.7, 0.2, -0.4]).as_matrix(), np.zeros(3)), FLAT, ON_TABLE,
                TABLE_TOP)
    hold(scene)
    for carried in (0.0, 0.5):
        scene.set_gains(ActionConfig(), 500.0, carried)
        scene.advance(400)
        force = 500.0 * scene.R_WH0 @ scene.read()[0][:3]
        assert force == pytest.approx([0, 0, 10.0 * carried - G * hanging], abs=1e-2)


LYING = transform(Rotation.from_rotvec([0, np.pi / 2, 0]).as_matrix(), np.array([1.0, 0.1, TABLE_TOP + 0.019]))
DOWN = np.eye(51)[2] * -0.03


def above(scene: OneScene) -> Array:
    """Lowest wrist pose (in steps of 2 mm) at which the flat hand, palm down, is clear of the lying box."""
    for height in np.arange(0.02, 0.08, 0.002):
        T = transform(np.eye(3), np.array([1.0, 0.1, TABLE_TOP + 0.038 + height]))
        scene.place(T, FLAT, LYING, TABLE_TOP)
        scene.advance(1)
        if not scene.read()[2].any():
            return T
    raise AssertionError("the hand is never clear of the box")


def press(scene: OneScene, T_WH: Array, substeps: int) -> None:
    """Start over with the hand above the box, and push it down."""
    scene.place(T_WH, FLAT, LYING, TABLE_TOP)
    assert scene.hand.contacts() == [] == scene.object.contacts()
    scene.set_gains(ActionConfig(), 500.0, 0.0)
    scene.set_target(DOWN)
    scene.advance(substeps)


def test_a_hand_that_presses_on_the_object_feels_it_part_by_part(scene: OneScene) -> None:
    press(scene, above(scene), 400)
    impulse = scene.read()[2]
    by_contact = np.zeros(16)
    for contact in scene.hand.contacts():
        if contact.body_b == scene.object.id:
            by_contact[list(scene.hand_model.part_links).index(contact.link_a)] += contact.impulse
    assert impulse == pytest.approx(by_contact, abs=1e-15)
    assert impulse.sum() > 0.001
    # The table carries the box and what the hand adds to its weight.
    on_table = sum(c.impulse * c.normal_W[2] for c in scene.object.contacts() if c.body_b == scene.table.id)
    down = sum(
        c.impulse * c.normal_W[2] + c.tangential_impulse_W[2]
        for c in scene.object.contacts() if c.body_b == scene.hand.id
    )
    weight = scene.object_model.mass * G * scene.world.timestep
    assert on_table == pytest.approx(weight - down, rel=0.02)


@pytest.mark.parametrize("collides", [True, False])
def test_the_hand_meets_the_table_only_where_configured(hand: HandModel, engine: str, collides: bool) -> None:
    scene = make_scene(hand, engine, hand_table_collision=collides)
    scene.place(transform(np.eye(3), np.array([1.0, 0.1, TABLE_TOP + 0.005])), FLAT,
                transform(np.eye(3), np.array([0.5, 0.4, TABLE_TOP + HEIGHT / 2])), TABLE_TOP)
    scene.advance(2)
    assert any(c.body_b == scene.table.id for c in scene.hand.contacts()) == collides
    scene.advance(20)
    assert scene.touches_table()
    scene.close()


def test_a_placed_scene_has_no_past(hand: HandModel, engine: str) -> None:
    """A hand that pressed, placed anew, does what it does in a fresh world, to the bit."""
    used, fresh = make_scene(hand, engine), make_scene(hand, engine)
    T_WH = above(used)
    press(used, T_WH, 200)
    states = []
    for scene in (used, fresh):
        press(scene, T_WH, 120)
        states.append([part.tolist() for part in scene.read()])
        scene.close()
    assert any(states[0][2])
    assert states[0] == states[1]
