"""The free labels that ship, and how they are made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dgrasp.config.experiment import make_config
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.files.paths import package_file
from dgrasp.hand.free.hand import URDF_PATH
from dgrasp.hand.free.skin import HAND_NAME
from dgrasp.hand.load import load_hand
from dgrasp.hand.model import HandModel
from dgrasp.hand.spheres import HandSpheres
from dgrasp.labels.formats.native import read_native_with_meta
from dgrasp.labels.recorded.making import split
from dgrasp.objects.catalogue import CATALOGUE
from dgrasp.objects.free import free_object
from dgrasp.scene.free_rest import lowest, place_at_rest
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.synthesis.path import DRAWN_BACK, START_CLEARANCE
from dgrasp.synthesis.synthesiser import MAX_DEPTH, MAX_TURNED
from dgrasp.types import GraspLabel
from raisim_like.shapes import Shape
from tests.engines import needs_pybullet
from tests.labels.distances import hand_bottom, part_distances, signed_distance

FILES = {name: package_file(f"data/free/labels/free_{name}.npz") for name in ("train", "test")}


@pytest.fixture(scope="module")
def hand() -> HandModel:
    return load_hand(URDF_PATH, HAND_NAME)


@pytest.fixture(scope="module")
def shipped() -> list[GraspLabel]:
    return [label for path in FILES.values() for label in read_native_with_meta(path)[0]]


def stack(labels: list[GraspLabel], name: str) -> np.ndarray:
    return np.array([getattr(label, name) for label in labels])


def of_object(labels: list[GraspLabel], name: str) -> list[GraspLabel]:
    return [label for label in labels if label.object_id == name]


# Distances ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "point", "expected"),
    [
        (Shape("box", (0.2, 0.4, 0.6)), (0.4, 0.6, 0.1), 0.5),  # 0.3 and 0.4 beyond two faces
        (Shape("box", (0.2, 0.4, 0.6)), (0.06, 0.0, 0.0), -0.04),
        (Shape("cylinder", (0.1, 0.4)), (0.0, 0.4, 0.6), 0.5),  # 0.3 from the mantle, 0.4 above the end
        (Shape("cylinder", (0.1, 0.4)), (0.0, 0.02, 0.17), -0.03),
        (Shape("capsule", (0.1, 0.4)), (0.3, 0.0, 0.6), 0.4),  # 0.5 from the end of its axis
        (Shape("sphere", (0.1,), position=(0.0, 0.0, 1.0)), (0.0, 0.0, 0.5), 0.4),
        # Turned by a quarter about x: its axis lies along y.
        (Shape("capsule", (0.1, 0.4), quaternion=(0.5**0.5, 0.5**0.5, 0.0, 0.0)), (0.0, 0.5, 0.0), 0.2),
    ],
)
def test_signed_distance(shape: Shape, point: tuple[float, float, float], expected: float) -> None:
    assert signed_distance([shape], np.array([[point]])) == pytest.approx(np.array([[expected]]), abs=1e-12)
    far = Shape("sphere", (0.1,), position=(9.0, 9.0, 9.0))
    assert signed_distance([far, shape], np.array(point)) == pytest.approx(expected, abs=1e-12)


def test_distance_to_a_mesh_is_refused() -> None:
    with pytest.raises(ValueError, match="hull"):
        signed_distance([Shape("hull", file=Path("a.obj"))], np.zeros((1, 3)))


def test_hand_parts_against_a_table_like_box(hand: HandModel) -> None:
    # The palm faces -y and its inner face is 18 mm from the wrist's axis; the flat hand's middle fingertip reaches
    # 8 mm below it. The box's face stands at y = -20 mm.
    box = [Shape("box", (2.0, 2.0, 2.0), position=(0.0, -1.02, 0.0))]
    T = np.eye(4)[None]
    distance = part_distances(hand, HandSpheres.of_hand(hand), box, T, np.zeros((1, 45)), T)[0]
    assert distance[6] == pytest.approx(0.012, abs=5e-4)
    assert distance[0] < 0.002
    moved = np.eye(4)[None].copy()
    moved[0, :3, 3] = 1.0, 2.0, 3.0
    again = part_distances(hand, HandSpheres.of_hand(hand), box, moved, np.zeros((1, 45)), moved)[0]
    assert again == pytest.approx(distance, abs=1e-12)


# Objects at rest -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [entry.name for entry in CATALOGUE])
def test_objects_rest_on_the_table(name: str) -> None:
    model = free_object(name, "ycb", True)
    for T in place_at_rest(model, np.random.default_rng(0), 8):
        assert T[2, 3] + lowest(model.shapes, T[:3, :3]) == pytest.approx(TABLE_TOP, abs=1e-12)


def test_lowest_point_of_a_tilted_box() -> None:
    c = 0.5**0.5
    R = np.array([[1.0, 0.0, 0.0], [0.0, c, -c], [0.0, c, c]])
    assert lowest([Shape("box", (1.0, 0.2, 0.4))], R) == pytest.approx(-c * 0.3)


# The labels that ship --------------------------------------------------------------------------------


def test_counts_and_description() -> None:
    for name, count in (("train", 376), ("test", 124)):
        labels, meta = read_native_with_meta(FILES[name])
        assert len(labels) == count
        assert (meta["hand"], meta["licence"], meta["sources"]) == ("free", "MIT", ["synthesised"])
        assert meta["objects"] == [entry.name for entry in CATALOGUE]
        for entry in CATALOGUE:
            mine = of_object(labels, entry.name)
            assert len(mine) in ((18, 19) if name == "train" else (6, 7))
            assert [label.index for label in mine] == list(range(len(mine)))
    assert sum(path.stat().st_size for path in FILES.values()) < 1_000_000


def test_no_grasp_comes_twice(shipped: list[GraspLabel]) -> None:
    assert len(np.unique(stack(shipped, "hand_pose"), axis=0)) == len(shipped)


def test_key_points_follow_from_the_pose(shipped: list[GraspLabel], hand: HandModel) -> None:
    pose, T = stack(shipped, "hand_pose"), stack(shipped, "T_WH")
    _, joints = hand.forward(np.concatenate([np.zeros((len(pose), 6)), pose], axis=1), T[:, :3, :3], T[:, :3, 3])
    assert np.abs(joints - stack(shipped, "joints_W")).max() < 1e-9


def test_angles_leave_the_limits_by_little(shipped: list[GraspLabel], hand: HandModel) -> None:
    pose = stack(shipped, "hand_pose")
    lower, upper = hand.limits[6:].T
    beyond = np.maximum(lower - pose, pose - upper)
    assert beyond.max() <= np.radians(8.0) + 1e-9
    assert (beyond.max(axis=1) <= 1e-9).any()
    start = np.array([label.start.hand_pose for label in shipped if label.start is not None])
    assert len(start) == len(shipped)
    assert np.maximum(lower - start, start - upper).max() <= 1e-9


@pytest.mark.parametrize("name", [entry.name for entry in CATALOGUE])
def test_hand_object_and_table(name: str, shipped: list[GraspLabel], hand: HandModel) -> None:
    labels, model, spheres = of_object(shipped, name), free_object(name, "ycb", True), HandSpheres.of_hand(hand)
    T_WH, T_WO, pose = (stack(labels, key) for key in ("T_WH", "T_WO", "hand_pose"))
    starts = [label.start for label in labels if label.start is not None]
    assert len(starts) == len(labels)
    T_WO_rest = np.array([start.T_WO for start in starts])
    for T in (*T_WO, *T_WO_rest):
        assert -1e-9 <= T[2, 3] + lowest(model.shapes, T[:3, :3]) - TABLE_TOP <= 0.005 + 1e-9
    assert np.abs(T_WO[:, :2] - T_WO_rest[:, :2]).max() < 1e-12
    distance = part_distances(hand, spheres, model.shapes, T_WH, pose, T_WO)
    contacts = stack(labels, "goal_contacts")
    # Labels are made with distances on a grid, exact to half a millimetre but at the edges of thin walls.
    assert (contacts != (distance < 0.015)).mean() < 0.015
    assert (contacts[:, 13:].any(axis=1) & contacts[:, 1:13].any(axis=1)).all()
    assert distance.min() > -MAX_DEPTH - 5e-4
    assert hand_bottom(hand, spheres, T_WH, pose).min() > TABLE_TOP
    start_WH, start_pose = np.array([s.T_WH for s in starts]), np.array([s.hand_pose for s in starts])
    assert hand_bottom(hand, spheres, start_WH, start_pose).min() > TABLE_TOP + START_CLEARANCE
    clear = part_distances(hand, spheres, model.shapes, start_WH, start_pose, T_WO_rest)
    assert clear.min() > START_CLEARANCE - 5e-4
    back = start_WH[:, :3, 3] - T_WH[:, :3, 3]
    drawn_back = np.linalg.norm(back, axis=1)
    assert drawn_back.min() > DRAWN_BACK[0] - 1e-4 and drawn_back.max() < DRAWN_BACK[1] + 1e-4
    # A hand that neither turns nor closes comes to the label's place without touching a thing.
    for share in (0.25, 0.5, 0.75, 1.0):
        way = start_WH.copy()
        way[:, :3, 3] -= share * back
        # At edges the grid's distances are a millimetre off at most.
        assert part_distances(hand, spheres, model.shapes, way, start_pose, T_WO_rest).min() > -1e-3
        assert hand_bottom(hand, spheres, way, start_pose).min() > TABLE_TOP
    # As an arm can turn it: the thumb's side not down, the fingers not up.
    knuckles = hand.offsets[[1, 4, 7, 10]].mean(axis=0)
    assert T_WH[:, 2, 2].min() > -MAX_TURNED
    assert (T_WH[:, 2, :3] @ knuckles).max() < MAX_TURNED * np.linalg.norm(knuckles)


@needs_pybullet
def test_a_hand_that_does_nothing_is_guided_to_the_grasp(hand: HandModel, shipped: list[GraspLabel]) -> None:
    """So that training can begin: closing the fingers is all that is left to learn."""
    names = ("004_sugar_box", "021_bleach_cleanser", "037_scissors")
    labels = [label for name in names for label in of_object(shipped, name)[:3]]
    config = make_config({"engine": "pybullet"}, "test")
    env = GraspEnv(labels, hand, {name: free_object(name, "official", True) for name in names}, config)
    env.reset(mode="test")
    for _ in range(40):
        env.step(np.zeros((len(labels), 51)))
    goal = np.array([np.linalg.inv(label.T_WO) @ label.T_WH for label in labels])[:, :3, 3]
    wrist = np.einsum("nji,nj->ni", env.s.R_WO, env.s.joints_W[:, 0] - env.s.object_pos_W)
    apart = np.linalg.norm(wrist - goal, axis=1)
    assert np.median(apart) < 0.01 and apart.max() < 0.03
    env.close()


def test_some_grasps_hold_and_some_do_not() -> None:
    """By the trial that chose them, which is told with the labels."""
    _, meta = read_native_with_meta(FILES["train"])
    figures = meta["provenance"]["per_object"]
    assert list(figures) == [entry.name for entry in CATALOGUE]
    assert 0.2 < sum(row["held"] for row in figures.values()) / 500 < 0.5
    assert np.mean([row["best_quarter_held"] for row in figures.values()]) > 0.6


def test_split_is_proportional_and_renumbered(shipped: list[GraspLabel]) -> None:
    lists = [shipped[:25], shipped[25:50], shipped[50:75]]
    train, test = split(lists, 20, seed=1)
    assert (len(train), len(test)) == (55, 20)
    assert sorted([label.index for label in test]) == sorted([*range(7), *range(7), *range(6)])
