"""The free hand's skin: MANO's layout, a closed surface of human measures on the free hand's joints, and poses."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.geometry.intersection import body, join
from dgrasp.hand.builder.segment import closed_volume, segment
from dgrasp.hand.free.anatomy import BONES, HAND_BREADTH
from dgrasp.hand.free.make_skin import SHAPES, rest_joints
from dgrasp.hand.free.rings import CUT, INDEX_BREADTH, THUMB_BREADTH, THUMB_THICKNESS, digit
from dgrasp.hand.free.skin import free_limits, free_skin
from dgrasp.hand.mano.model import ManoModel
from dgrasp.hand.mano.pose import from_pca, project_pose
from dgrasp.hand.mano.skeleton import FINGERS, PART_PARENT, PARTS, SEGMENTS
from dgrasp.hand.mano.skinning import euler_rotations, numpy_skin
from dgrasp.types import Array
from tests.hand.test_free_hand import PINCHES
from tests.scenes import free_hand


@pytest.fixture(scope="module")
def model() -> ManoModel:
    return free_skin()


def angles_of(flexed: dict[str, tuple[float, float, float]]) -> Array:
    """(45,) rad of degrees about x, y, z per part."""
    angles = np.zeros((15, 3))
    for part, degrees in flexed.items():
        angles[PARTS.index(part) - 1] = np.radians(degrees)
    return angles.reshape(45)


FIST = {f"{f}_{s}": (0.0, 0.0, a) for f in FINGERS[:4] for s, a in zip(SEGMENTS, (80.0, 95.0, 60.0), strict=True)}
POSES = {
    "fist": angles_of(FIST),
    "fist with the thumb across": angles_of(FIST | {p: v for p, v in PINCHES["little"].items() if "thumb" in p}),
    **{f"{finger} pinch": angles_of(PINCHES[finger]) for finger in PINCHES},
}


def posed(model: ManoModel, angles: Array) -> tuple[Array, Array]:
    """Vertices (V, 3) and key points (21, 3) with the wrist at the origin."""
    rotations = np.concatenate([np.eye(3)[None], euler_rotations(angles.reshape(15, 3))])[None]
    vertices, keypoints = numpy_skin(model).forward(rotations, np.zeros((1, 3)))
    return vertices[0], keypoints[0]


def edge_count(faces: Array) -> tuple[Array, Array]:
    """Edges (E, 2), lower number first, and how many faces each has."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def slice_at(model: ManoModel, axis: int, value: float) -> Array:
    """(N, 3) where the edges of the mean hand cross a plane."""
    ends = model.template[edge_count(model.faces)[0]]
    ends = ends[(ends[:, 0, axis] < value) != (ends[:, 1, axis] < value)]
    share = (value - ends[:, :1, axis]) / (ends[:, 1:, axis] - ends[:, :1, axis])
    return ends[:, 0] * (1 - share) + ends[:, 1] * share


def test_layout(model: ManoModel) -> None:
    assert model.template.shape == (778, 3) and model.faces.shape == (1526, 3) and model.side == "right"
    assert model.shape_basis.shape == (778, 3, len(SHAPES)) and model.pose_basis.shape == (778, 3, 135)
    # Where MANO's tips are looked for.
    assert model.tip_vertices.tolist() == [317, 444, 556, 673, 745]


def test_the_surface_has_no_gap_but_the_wrist(model: ManoModel) -> None:
    edges, count = edge_count(model.faces)
    assert count.max() == 2
    rim = edges[count == 1]
    assert len(rim) == 28 == len(np.unique(rim))
    assert np.abs(model.template[rim, 0] - CUT).max() < 1e-8
    # One piece with one hole: V - E + F = 1, and every vertex is reached from the first.
    assert len(model.template) - len(edges) + len(model.faces) == 1
    reached = np.zeros(778, bool)
    reached[0] = True
    for _ in range(100):
        touched = reached[edges].any(axis=1)
        reached[edges[touched].ravel()] = True
    assert reached.all()
    directed = np.concatenate([model.faces[:, [0, 1]], model.faces[:, [1, 2]], model.faces[:, [2, 0]]])
    assert len(np.unique(directed, axis=0)) == len(directed)
    a, b, c = np.moveaxis(model.template[model.faces], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 4e-7


def test_joints_and_tips_are_the_free_hands(model: ManoModel) -> None:
    hand = free_hand()
    vertices, joints = model.shaped(np.zeros(0))
    assert np.abs(joints - rest_joints()).max() < 1e-9
    steps = joints[1:] - joints[list(PART_PARENT[1:])]
    assert np.abs(steps - hand.offsets[1:]).max() < 1e-6 and np.abs(joints[0]).max() < 1e-9
    tips = vertices[model.tip_vertices] - joints[[3, 6, 9, 12, 15]]
    assert np.abs(tips - hand.tips).max() < 1e-6
    assert np.abs(free_limits() - hand.limits[6:]).max() < 6e-6
    assert model.J_regressor.min() >= 0.0 and model.J_regressor.sum(axis=1) == pytest.approx(np.ones(16), abs=1e-12)


def test_key_points_are_the_free_hands_in_any_pose(model: ManoModel) -> None:
    hand, rng = free_hand(), np.random.default_rng(0)
    for _ in range(4):
        angles = rng.uniform(*hand.limits[6:].T)
        _, expected = hand.forward(np.concatenate([np.zeros(6), angles])[None], np.eye(3)[None], np.zeros((1, 3)))
        assert np.abs(posed(model, angles)[1] - expected[0]).max() < 4e-6


def test_weights_are_local_and_sum_to_one(model: ManoModel) -> None:
    weights = model.part_weights()
    assert weights.min() >= 0.0 and np.abs(weights.sum(axis=1) - 1.0).max() < 3e-9
    assert (weights > 0).sum(axis=1).max() <= 3
    for index, finger in enumerate(FINGERS):
        own, mine = digit(finger), weights[:, 1 + 3 * index : 4 + 3 * index].sum(axis=1)
        at = model.template - own.origin
        along = np.clip(at @ own.along, 0.0, sum(BONES[finger]))
        away = np.linalg.norm(at - along[:, None] * own.along, axis=1)
        # The thumb's base draws on the palm from farther away.
        near, far = (0.036, 0.060) if finger == "thumb" else (0.030, 0.030)
        assert away[mine > 0.2].max() < near and away[mine > 0].max() < far, finger
        assert weights[model.tip_vertices[index], 3 + 3 * index] == 1.0
    # Two digits share skin only in the webs, where neither has more than half (next to the thumb a little more).
    digits = np.stack([weights[:, 1 + 3 * f : 4 + 3 * f].sum(axis=1) for f in range(5)], axis=1)
    second = np.sort(digits, axis=1)[:, -2]
    assert second.max() <= 0.5 and (second > 0.1).sum() < 60


def test_measures_are_human(model: ManoModel) -> None:
    v = model.template
    # Mass shares of hands, 0.61% of 73 kg and 0.56% of 62 kg (de Leva, J. Biomech. 29, 1996), at 1.16 g/cm3.
    assert 280e-6 < closed_volume(v, model.faces) < 400e-6
    # Hand length of British men and women, 5th to 95th percentile: 159 to 205 mm.
    assert 0.159 < CUT - v[:, 0].min() < 0.205
    knuckle = slice_at(model, 0, rest_joints()[4, 0])
    fingers = knuckle[knuckle[:, 2] < 0.036]
    assert np.ptp(fingers[:, 2]) == pytest.approx(HAND_BREADTH, abs=0.006)
    middle = np.abs(fingers[:, 2]) < 0.004
    assert np.ptp(fingers[middle, 1]) == pytest.approx(0.0305, abs=0.004)
    for finger, bone, breadth, thickness in (
        ("index", 1, INDEX_BREADTH, 0.0175), ("thumb", 2, THUMB_BREADTH, 0.96 * THUMB_THICKNESS),
    ):  # fmt: skip
        own = digit(finger)
        ring = (v - own.origin)[np.abs((v - own.origin) @ own.along - own.at(bone)) < 1e-6]
        ring = ring[np.linalg.norm(ring - own.at(bone) * own.along, axis=1) < 0.015]
        assert len(ring) == (10 if finger == "index" else 12)
        # The rings' vertices lie around ellipses; none is at an end of the smaller axis.
        x, y = ring @ own.side / (breadth / 2), (ring @ own.back - (ring @ own.back).mean()) / (thickness / 2)
        assert np.hypot(x, y) == pytest.approx(np.ones(len(ring)), abs=1e-6)


@pytest.mark.parametrize("name", POSES)
def test_strong_poses_keep_the_hand_whole(model: ManoModel, name: str) -> None:
    vertices, _ = posed(model, POSES[name])
    rest = closed_volume(model.template, model.faces)
    assert 0.87 * rest < closed_volume(vertices, model.faces) < 1.02 * rest
    parts = segment(vertices, model.faces, model.part_weights(), np.zeros((16, 3)))
    assert min(part.volume for part in parts) > 1e-6
    pieces = [body([(part.vertices, part.faces)]) for part in parts]
    assert all(piece.solid is not None and piece.holes == 0 for piece in pieces)
    # Where the hand touches itself it may run through itself a little.
    assert join(pieces).solid.volume() > 0.95 * sum(part.volume for part in parts)
    # Few faces turn against the part that they belong to: folds at the creases.
    turns = [np.eye(3)]
    for part, turn in enumerate(euler_rotations(POSES[name].reshape(15, 3)), start=1):
        turns.append(turns[PART_PARENT[part]] @ turn)
    owner = model.part_weights()[model.faces].sum(axis=1).argmax(axis=1)
    before, after = (np.cross(v[model.faces[:, 1]] - v[model.faces[:, 0]], v[model.faces[:, 2]] - v[model.faces[:, 0]])
                     for v in (model.template, vertices))
    carried = np.einsum("fij,fj->fi", np.array(turns)[owner], before)
    assert ((carried * after).sum(axis=1) < 0.0).mean() < 0.02


def test_bent_knuckles_keep_more_flesh_than_by_blending_alone(model: ManoModel) -> None:
    weights = model.part_weights()
    pip = np.flatnonzero(np.abs(weights[:, PARTS.index("index_middle")] - 0.5) < 0.02)
    at = model.template[pip] - rest_joints()[2]
    top = pip[(at @ digit("index").back).argmax()]
    vertices, keypoints = posed(model, angles_of({"index_middle": (0.0, 0.0, 90.0)}))
    # In the plane of the motion, across the axis z.
    height = np.linalg.norm((vertices[top] - keypoints[2])[:2])
    rest = np.linalg.norm((model.template[top] - rest_joints()[2])[:2])
    # Half of each of two frames at right angles: 1 / sqrt(2) of the height, and a quarter more with the correction.
    assert height / rest == pytest.approx(1.25 / np.sqrt(2.0), abs=0.01)


def test_sixteen_closed_parts_make_up_the_hand(model: ManoModel) -> None:
    import trimesh

    vertices, joints = model.shaped(np.zeros(0))
    parts = segment(vertices, model.faces, model.part_weights(), joints)
    assert [part.name for part in parts] == list(PARTS)
    assert all(trimesh.Trimesh(p.vertices, p.faces, process=False).is_watertight for p in parts)
    assert sum(p.volume for p in parts) == pytest.approx(closed_volume(vertices, model.faces), rel=1e-12)
    assert 0.6 < parts[0].volume / sum(p.volume for p in parts) < 0.75


def test_shape_parameters_do_what_they_say(model: ManoModel) -> None:
    v, joints = model.shaped(np.zeros(0))

    def bones(vertices: Array, j: Array) -> Array:
        chains = [np.vstack([j[1 + 3 * f : 4 + 3 * f], vertices[model.tip_vertices[f]]]) for f in range(5)]
        return np.array([np.linalg.norm(np.diff(chain, axis=0), axis=1) for chain in chains])

    def ratios(index: int, beta: float = 1.0) -> tuple[Array, Array, Array, float]:
        """Of bones (5, 3), of the knuckles' breadth and palm's thickness (2,), of the girth of DIP rings, of volume."""
        w, j = model.shaped(np.eye(len(SHAPES))[index] * beta)
        ring = [np.abs((v - digit(f).origin) @ digit(f).along - digit(f).at(2)) < 1e-6 for f in FINGERS]
        girth = [np.linalg.norm((w - w[r].mean(axis=0))[r], axis=1).mean()
                 / np.linalg.norm((v - v[r].mean(axis=0))[r], axis=1).mean() for r in ring]
        breadth = (j[1, 2] - j[10, 2]) / (joints[1, 2] - joints[10, 2])
        palm = model.part_weights()[:, 0] == 1.0
        thick = np.ptp(w[palm, 1]) / np.ptp(v[palm, 1])
        return (bones(w, j) / bones(v, joints), np.array([breadth, thick]), np.array(girth),
                closed_volume(w, model.faces) / closed_volume(v, model.faces))

    units = dict(SHAPES)
    size, length, girth, breadth, thickness, thumb = (1.0 + unit for unit in units.values())
    one, near = np.ones((5, 3)), {"abs": 0.012}
    found = ratios(0)
    assert found[0] == pytest.approx(size * one) and found[1] == pytest.approx([size] * 2)
    assert found[3] == pytest.approx(size**3)
    assert ratios(0, -1.0)[0] == pytest.approx((2.0 - size) * one)
    found = ratios(1)
    assert found[0][:4] == pytest.approx(length * one[:4], **near) and found[0][4] == pytest.approx(one[4], **near)
    assert found[1] == pytest.approx([1.0, 1.0], **near) and found[2] == pytest.approx(np.ones(5), **near)
    found = ratios(2)
    assert found[0] == pytest.approx(one, **near) and found[2] == pytest.approx(girth * np.ones(5), **near)
    found = ratios(3)
    assert found[0] == pytest.approx(one, **near) and found[1] == pytest.approx([breadth, 1.0], **near)
    found = ratios(4)
    assert found[0] == pytest.approx(one, **near) and found[1] == pytest.approx([1.0, thickness], **near)
    found = ratios(5)
    assert found[0][:4] == pytest.approx(one[:4], **near) and found[0][4] == pytest.approx(thumb * one[4], **near)


def test_poses_of_the_components(model: ManoModel) -> None:
    assert np.abs(model.hands_components @ model.hands_components.T - np.eye(45)).max() < 1e-12
    lower, upper = free_hand().limits[6:].T
    relaxed, closed = (project_pose(from_pca(model, np.array([[c]]), False))[0] for c in (0.0, 1.5))
    assert (lower < relaxed).all() and (relaxed < upper).all()
    palm = np.array([-0.08, -0.03, 0.0])
    far = [np.linalg.norm(posed(model, a)[1][[8, 12, 16]] - palm, axis=1) for a in (np.zeros(45), relaxed, closed)]
    assert (far[1] < far[0] - 0.01).all() and (far[2] < far[1] - 0.01).all()
