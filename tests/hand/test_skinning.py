"""Forward skinning against a slow, plain reference; numpy against torch; gradients; poses to MANO and back; mirrors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from dgrasp.errors import DataError
from dgrasp.hand.mano.file import read_mano
from dgrasp.hand.mano.model import MIRROR, MIRROR_ANGLES, ManoModel, mirror_mano
from dgrasp.hand.mano.pose import from_pca, mano_pose, project_pose, to_pca
from dgrasp.hand.mano.skeleton import KEYPOINTS
from dgrasp.hand.mano.skinning import axis_angle_rotations, euler_rotations, numpy_skin, torch_skin
from dgrasp.types import Array
from raisim_like.rotations import matrix_from_euler
from tests.hand.mano_file import MANO_ORDER, mano_arrays, write_mano


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ManoModel:
    return read_mano(write_mano(tmp_path_factory.mktemp("mano") / "MANO_RIGHT.pkl"))


def plain_reference(arrays: dict[str, Array], vectors: Array, translation: Array, betas: Array) -> tuple[Array, Array]:
    """Vertices (V, 3) and joints (16, 3), MANO's order, vertex by vertex as MANO's paper writes it.

    vectors (16, 3): rotation vectors, MANO's order. translation (3,): added to all, MANO's own.
    """
    n = len(arrays["v_template"])
    R = [Rotation.from_rotvec(v).as_matrix() for v in vectors]
    shaped = [arrays["v_template"][v] + arrays["shapedirs"][v] @ betas for v in range(n)]
    joints = [sum(arrays["J_regressor"][j, v] * shaped[v] for v in range(n)) for j in range(16)]
    feature = np.concatenate([(R[j] - np.eye(3)).reshape(-1) for j in range(1, 16)])
    chain: list[Array] = []
    for j in range(16):
        local = np.eye(4)
        local[:3, :3] = R[j]
        parent = int(arrays["kintree_table"][0, j])
        local[:3, 3] = joints[j] - (joints[parent] if j else 0.0)
        chain.append(chain[parent] @ local if j else local)
    vertices = []
    for v in range(n):
        posed = np.append(shaped[v] + arrays["posedirs"][v] @ feature, 1.0)
        blended = np.zeros(4)
        for j in range(16):
            # From the rest pose, where the joint's frame is at its place and not turned.
            rest = np.eye(4)
            rest[:3, 3] = -joints[j]
            blended += arrays["weights"][v, j] * (chain[j] @ rest @ posed)
        vertices.append(blended[:3] + translation)
    return np.array(vertices), np.array([T[:3, 3] for T in chain]) + translation


def random_pose(n: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """Angles (n, 16, 3) in the project's order, wrists (n, 3), betas (n, 10)."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.2, 1.2, (n, 16, 3)), rng.normal(size=(n, 3)), rng.normal(size=(n, 10))


def test_against_the_plain_reference(model: ManoModel) -> None:
    arrays = mano_arrays()
    skin = numpy_skin(model)
    rng = np.random.default_rng(1)
    vectors, translation, betas = rng.normal(0, 0.7, (2, 16, 3)), rng.normal(size=(2, 3)), rng.normal(size=(2, 10))
    order = [0, *range(1, 7), *range(10, 13), *range(7, 10), *range(13, 16)]
    wrist = skin.rest(betas)[1][:, 0] + translation
    vertices, keypoints = skin.forward(axis_angle_rotations(vectors[:, order]), wrist, betas)
    assert vertices.shape == (2, len(model.template), 3) and keypoints.shape == (2, 21, 3)
    for i in range(2):
        expected, joints = plain_reference(arrays, vectors[i], translation[i], betas[i])
        assert np.abs(vertices[i] - expected).max() < 1e-12
        assert np.abs(keypoints[i, 0] - joints[0]).max() < 1e-12
        for f, finger in enumerate(MANO_ORDER):
            first = KEYPOINTS.index(f"{finger}_proximal")
            assert np.abs(keypoints[i, first : first + 3] - joints[1 + 3 * f : 4 + 3 * f]).max() < 1e-12
        tips = keypoints[i, [KEYPOINTS.index(f"{f}_tip") for f in ("index", "middle", "ring", "little", "thumb")]]
        assert np.array_equal(tips, vertices[i, model.tip_vertices])


def test_numpy_and_torch_agree(model: ManoModel) -> None:
    angles, wrist, betas = random_pose(5)
    for rotations in (euler_rotations, axis_angle_rotations):
        ours = numpy_skin(model).forward(rotations(angles), wrist, betas)
        theirs = torch_skin(model).forward(
            rotations(torch.as_tensor(angles)), torch.as_tensor(wrist), torch.as_tensor(betas)
        )
        for a, b in zip(ours, theirs, strict=True):
            assert np.abs(a - b.numpy()).max() < 1e-12
        single = torch_skin(model, torch.float32).forward(
            *(torch.as_tensor(a, dtype=torch.float32) for a in (rotations(angles), wrist, betas))
        )
        assert np.abs(ours[0] - single[0].numpy()).max() < 1e-6 and single[0].dtype == torch.float32


def test_rotations() -> None:
    angles = random_pose(20, seed=2)[0]
    assert np.abs(euler_rotations(angles) - matrix_from_euler(angles)).max() < 1e-15
    vectors = np.concatenate([angles.reshape(-1, 3), np.zeros((1, 3)), [[1e-9, 0, 0], [3.1, 0.2, -0.1]]])
    assert np.abs(axis_angle_rotations(vectors) - Rotation.from_rotvec(vectors).as_matrix()).max() < 1e-14


def test_gradients(model: ManoModel) -> None:
    skin = torch_skin(model)
    angles, wrist, betas = (torch.as_tensor(a[:1]).requires_grad_() for a in random_pose(1, seed=3))
    rng = np.random.default_rng(4)
    some = torch.as_tensor(rng.choice(len(model.template), 5, replace=False))

    def outcome(angles: torch.Tensor, wrist: torch.Tensor, betas: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        vertices, keypoints = skin.forward(euler_rotations(angles), wrist, betas)
        return vertices[:, some], keypoints

    assert torch.autograd.gradcheck(outcome, (angles, wrist, betas), atol=1e-7, fast_mode=True)
    # At zero the rotation vector's length has no derivative; the rotation has.
    zero = torch.zeros(1, 16, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: skin.forward(axis_angle_rotations(v), wrist)[1], (zero,), atol=1e-6)


def test_rigid_motion_and_zero_pose(model: ManoModel) -> None:
    skin = numpy_skin(model)
    angles, wrist, betas = random_pose(3, seed=5)
    rotations = euler_rotations(angles)
    vertices, keypoints = skin.forward(rotations, wrist, betas)
    turn, shift = Rotation.random(random_state=0).as_matrix(), np.array([0.3, -0.2, 0.5])
    moved = rotations.copy()
    moved[:, 0] = turn @ rotations[:, 0]
    turned, points = skin.forward(moved, wrist @ turn.T + shift, betas)
    assert np.abs(turned - (vertices @ turn.T + shift)).max() < 1e-12
    assert np.abs(points - (keypoints @ turn.T + shift)).max() < 1e-12
    rest, joints = skin.rest(betas)
    flat, points = skin.forward(np.tile(np.eye(3), (3, 16, 1, 1)), joints[:, 0], betas)
    assert np.abs(flat - rest).max() < 1e-12
    # One shape for all poses, fewer betas than the model has, and none.
    one = skin.forward(rotations, wrist, betas[:1, :2])[0]
    padded = np.concatenate([betas[:1, :2], np.zeros((1, 8))], axis=1)
    assert np.abs(one - skin.forward(rotations, wrist, np.tile(padded, (3, 1)))[0]).max() < 1e-12
    assert np.abs(skin.forward(rotations, wrist)[0] - skin.forward(rotations, wrist, 0 * betas)[0]).max() < 1e-12


def test_poses_to_mano_and_back(model: ManoModel) -> None:
    rng = np.random.default_rng(6)
    angles = rng.uniform(-1.4, 1.4, (50, 45))
    assert np.abs(project_pose(mano_pose(angles)) - angles).max() < 1e-9
    vectors = rng.uniform(-1.0, 1.0, (50, 45))
    assert np.abs(mano_pose(project_pose(vectors)) - vectors).max() < 1e-9
    # The ring finger's first joint is MANO's tenth and the project's seventh.
    only = np.zeros((1, 45))
    only[0, 3 * 9 : 3 * 9 + 3] = [0.0, 0.0, 0.5]
    assert project_pose(only)[0].nonzero()[0].tolist() == [3 * 6 + 2]
    for flat in (True, False):
        coefficients = to_pca(model, vectors, flat)
        assert np.abs(from_pca(model, coefficients, flat) - vectors).max() < 1e-9
        few = from_pca(model, coefficients[:, :6], flat)
        mean = np.zeros(45) if flat else model.hands_mean
        assert np.abs(few - mean - coefficients[:, :6] @ model.hands_components[:6]).max() < 1e-12
    assert np.array_equal(from_pca(model, np.zeros((1, 45)), False)[0], model.hands_mean)
    with pytest.raises(DataError, match="expected"):
        project_pose(np.zeros((2, 48)))
    with pytest.raises(DataError, match="expected"):
        from_pca(model, np.zeros((2, 46)), True)


def test_the_same_pose_by_angles_and_by_rotation_vectors(model: ManoModel) -> None:
    skin = numpy_skin(model)
    hand_pose = np.random.default_rng(7).uniform(-1, 1, (2, 45))
    angles = np.concatenate([np.zeros((2, 3)), hand_pose], axis=1).reshape(2, 16, 3)
    by_angles = skin.forward(euler_rotations(angles), np.zeros((2, 3)))[1]
    vectors = mano_pose(hand_pose).reshape(2, 5, 3, 3)[:, [0, 1, 3, 2, 4]].reshape(2, 15, 3)
    rotations = axis_angle_rotations(np.concatenate([np.zeros((2, 1, 3)), vectors], axis=1))
    assert np.abs(skin.forward(rotations, np.zeros((2, 3)))[1] - by_angles).max() < 1e-12


def test_the_mirrored_hand_moves_like_the_mirror_image(model: ManoModel, tmp_path: Path) -> None:
    other = mirror_mano(model)
    assert other.side == "left"
    angles, wrist, betas = random_pose(4, seed=8)
    vertices, keypoints = numpy_skin(model).forward(euler_rotations(angles), wrist, betas)
    mirrored, points = numpy_skin(other).forward(euler_rotations(angles * MIRROR_ANGLES), wrist * MIRROR, betas)
    assert np.abs(mirrored - vertices * MIRROR).max() < 1e-12
    assert np.abs(points - keypoints * MIRROR).max() < 1e-12
    coefficients = np.random.default_rng(9).normal(size=(3, 45))
    here, there = (from_pca(m, coefficients, False).reshape(3, 15, 3) for m in (model, other))
    assert np.abs(there - here * MIRROR_ANGLES).max() < 1e-12
    back = mirror_mano(other)
    for field in ("template", "shape_basis", "pose_basis", "faces", "hands_mean", "hands_components"):
        assert np.array_equal(getattr(back, field), getattr(model, field)), field
    # Like a file of a left hand.
    assert np.array_equal(other.template, mano_arrays(side="left")["v_template"])
