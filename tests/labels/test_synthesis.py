"""Synthesised grasps: the energies, the descent, and the labels that come of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from dgrasp.cli import run_command
from dgrasp.config.experiment import make_config
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.errors import ConfigError
from dgrasp.geometry import approximate
from dgrasp.geometry.distance_grid import distance_grid
from dgrasp.geometry.intersection import body
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.hand.mano.skeleton import N_PARTS
from dgrasp.hand.spheres import HandSpheres
from dgrasp.hand.store import open_hand
from dgrasp.labels.recorded.surfaces import Surfaces
from dgrasp.objects.free import free_object
from dgrasp.objects.model import object_model
from dgrasp.objects.store import load_object
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.synthesis import synthesiser as synthesis
from dgrasp.synthesis import trial as synth_trial
from dgrasp.synthesis.energy import Grasps, energies, let_yield, optimise, residual_wrench, unnatural
from dgrasp.synthesis.path import free_starts
from dgrasp.synthesis.progress import SearchShare, search_and_trial
from dgrasp.synthesis.start import Setting, propose
from dgrasp.synthesis.synthesiser import Synthesiser
from dgrasp.synthesis.torch_hand import ObjectField, TorchHand, tensor
from dgrasp.synthesis.trial import gt_pd_holds, outlasts_window
from dgrasp.types import Array, GraspLabel
from raisim_like import registry
from raisim_like.shapes import Shape
from tests.labels.distances import hand_bottom, part_distances
from tests.objects.meshes import box, save
from tests.scenes import free_hand

BRICK = "061_foam_brick"
QUICK = {"eval": {"window_s": 0.1}, "physics": {"preset": "fast"}}
"""Values of a config for short trials."""


@pytest.fixture(scope="module")
def hand() -> TorchHand:
    return TorchHand(free_hand())


@pytest.fixture(scope="module")
def setting() -> Setting:
    model = free_object(BRICK, "official", True)
    united = body([shape_mesh(shape) for shape in model.shapes])
    return Setting(model, united, ObjectField(distance_grid(united, pitch=0.006)))


# Energies ------------------------------------------------------------------------------------------


def test_opposed_forces_close_and_forces_of_one_side_do_not() -> None:
    point = torch.zeros(2, N_PARTS, 3)
    normal = torch.zeros(2, N_PARTS, 3)
    wanted = torch.zeros(2, N_PARTS, dtype=torch.bool)
    wanted[:, [3, 15]] = True
    point[:, 3, 0], point[:, 15, 0] = 0.04, -0.04
    normal[:, 3, 0] = 1.0
    normal[0, 15, 0], normal[1, 15, 0] = -1.0, 1.0
    force, torque = residual_wrench(point, normal, torch.zeros(2, N_PARTS), wanted, torch.zeros(3))
    assert force.numpy() == pytest.approx(np.array([[0, 0, 0], [-1, 0, 0]]), abs=1e-6)
    assert torque.abs().max() == 0.0
    # Three quarters of the force on one of two opposed parts leave half of it.
    shares = torch.zeros(2, N_PARTS)
    shares[:, 3] = float(np.log(3.0))
    force, _ = residual_wrench(point, normal, shares, wanted, torch.zeros(3))
    assert force[0].numpy() == pytest.approx([-0.5, 0.0, 0.0], abs=1e-6)
    # 0.04 m beside the centre the lever is 1.
    _, torque = residual_wrench(point, normal, torch.zeros(2, N_PARTS), wanted, torch.tensor([0.0, 0.04, 0.0]))
    assert torque[1].numpy() == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)


def one_hand(hand: TorchHand, height: float) -> Grasps:
    """A mean hand far from the object, its wrist `height` over the table, the palm down."""
    R = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]])
    wanted = torch.zeros(1, N_PARTS, dtype=torch.bool)
    wanted[:, [3, 15]] = True
    return Grasps(R, torch.tensor([[1.0, 1.0, height]]), tensor(hand.motions.mean[None]), wanted,
                  torch.tensor([[0.0, 0.0, 1.0]]), torch.zeros(1), torch.zeros(1, 45, dtype=torch.bool),
                  torch.zeros(1, 45))  # fmt: skip


def test_terms_of_a_hand_that_touches_nothing(hand: TorchHand, setting: Setting) -> None:
    terms = energies(hand, setting.field, one_hand(hand, 1.0), torch.zeros(1, N_PARTS), torch.zeros(3))
    for name in ("penetration", "self", "table", "limits", "prior", "upright"):
        assert float(terms[name]) == pytest.approx(0.0, abs=1e-6), name
    assert float(terms["contact"]) > 100.0
    sunk = energies(hand, setting.field, one_hand(hand, -0.1), torch.zeros(1, N_PARTS), torch.zeros(3))
    assert float(sunk["table"]) > 1.0


def test_wrists_that_no_arm_turns_like_that_cost(hand: TorchHand, monkeypatch: pytest.MonkeyPatch) -> None:
    """Palm down, thumb to the side; then the thumb down, and the fingers up, by 30 degrees each."""
    palm_down = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    turns = Rotation.from_euler("xyz", [[0, 0, 0], [30, 0, 0], [-30, 0, 0], [0, 30, 0], [0, -30, 0]], degrees=True)
    R, up = tensor(turns.as_matrix() @ palm_down), tensor(np.tile([0.0, 0.0, 1.0], (5, 1)))
    side, pointing = unnatural(hand, R, up).numpy().T
    assert side == pytest.approx([0.0, 0.5, 0.0, 0.0, 0.0], abs=0.02)
    # The fingers point along -x.
    assert pointing == pytest.approx([0.0, 0.0, 0.0, 0.5, 0.0], abs=0.06)
    # Of a left hand, the thumb is at the other end of z.
    monkeypatch.setattr(hand, "motions", replace(hand.motions, thumb_side=-1.0))
    assert unnatural(hand, R, up).numpy()[:, 0] == pytest.approx([0.0, 0.0, 0.5, 0.0, 0.0], abs=0.02)


def test_a_round_without_sound_grasps_has_no_starts(hand: TorchHand, setting: Setting) -> None:
    none = one_hand(hand, 1.0).take(torch.zeros(0, dtype=torch.long))
    starts, free = free_starts(hand, setting, none, np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), np.random.default_rng(0))
    assert starts == [] and free.shape == (0,)


def test_the_descent_brings_the_hand_to_the_object(hand: TorchHand, setting: Setting) -> None:
    rng = np.random.default_rng(3)
    T_WO = np.tile(np.eye(4), (4, 1, 1))
    T_WO[:, 2, 3] = TABLE_TOP + 0.025
    start = propose(hand, setting, T_WO, rng)
    before = energies(hand, setting.field, start, torch.zeros(4, N_PARTS), torch.zeros(3))
    found, after = optimise(hand, setting.field, start, np.zeros(3), iterations=30)
    assert after["contact"].mean() < 0.6 * before["contact"].mean()
    assert after["closure"].mean() < before["closure"].mean()
    yielding = let_yield(hand, setting.field, found, rng)
    pose, (low, high) = yielding.pose(hand), hand.limits
    beyond, yields = np.degrees(torch.maximum(low - pose, pose - high).numpy()), yielding.yields.numpy()
    assert yields.any() and (beyond[yields] <= 7.0 + 1e-3).all() and (beyond[yields] >= 1.5 - 1e-3).all()
    assert beyond[~yields].max() <= 1e-4


# Labels --------------------------------------------------------------------------------------------


def few(seed: int, told: list[float] | None = None) -> synthesis.Synthesised:
    """Three labels; a batch of 48 hands has the nine sound grasps that are tried, so one round is enough."""
    config = make_config(QUICK, "test")
    model = free_object(BRICK, "official", True)
    report = [].append if told is None else told.append
    return Synthesiser(free_hand()).make(model, 3, np.random.default_rng(seed), config, 48, 36, report)


@pytest.fixture(scope="module")
def made() -> synthesis.Synthesised:
    return few(1)


def test_labels_are_sound(made: synthesis.Synthesised, hand: TorchHand) -> None:
    model, spheres = free_object(BRICK, "official", True), HandSpheres.of_hand(hand.model)
    assert len(made.labels) == len(made.held) == len(made.quality) == 3
    T_WH, T_WO, pose = (np.stack([getattr(label, k) for label in made.labels]) for k in ("T_WH", "T_WO", "hand_pose"))
    apart = part_distances(hand.model, spheres, model.shapes, T_WH, pose, T_WO)
    # The grid's distances are exact to half a millimetre.
    assert apart.min() > -synthesis.MAX_DEPTH - 5e-4
    assert hand_bottom(hand.model, spheres, T_WH, pose).min() > TABLE_TOP - 1e-4
    for label, mine in zip(made.labels, apart, strict=True):
        assert label.goal_contacts[np.abs(mine - 0.015) > 5e-4].tolist() == (mine < 0.015)[
            np.abs(mine - 0.015) > 5e-4
        ].tolist()
        assert label.goal_contacts[13:].any() and label.goal_contacts[1:13].sum() >= 2
        assert label.start is not None and (label.start.hand_pose >= hand.model.limits[6:, 0]).all()


def test_same_seed_same_labels_whatever_the_callers_generator_which_stays_as_it_is(made: synthesis.Synthesised) -> None:
    torch.manual_seed(123)
    before = torch.get_rng_state()
    told: list[float] = []
    again = few(1, told)
    assert torch.equal(torch.get_rng_state(), before)
    for a, b in zip(made.labels, again.labels, strict=True):
        assert np.array_equal(a.hand_pose, b.hand_pose) and np.array_equal(a.T_WH, b.T_WH)
        assert a.start is not None and b.start is not None and np.array_equal(a.start.T_WH, b.start.T_WH)
    assert np.array_equal(made.held, again.held)
    # It says how far it is, after each step of the descents (36 + 18 per round) and of the trial.
    config = make_config(QUICK)
    search, trial = search_and_trial(config.engine)
    steps = sum(share > search for share in told)
    assert told == sorted(told) and told[-1] == pytest.approx(search + trial)
    assert steps == config.window_steps
    assert (len(told) - steps) % (36 + 18 + 1) == 0 and len(set(told)) > 50


def test_a_left_hand_of_hulls_and_an_added_object(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(approximate, "_FIT_POINTS", 500)
    monkeypatch.setenv("DGRASP_CACHE", str(tmp_path / "cache"))
    left = tmp_path / "left"
    assert run_command("hand build", ["--free", "--side", "left", "--shapes", "hulls", "--out", str(left)]) == 0
    mesh = save(box((0.05, 0.07, 0.12)), tmp_path / "carton.obj")
    words = [str(mesh), "--mass", "0.2", "--to", str(tmp_path / "mine"), "--shape", "box"]
    assert run_command("object add", words) == 0
    model, named = load_object(tmp_path / "mine" / "carton", True), open_hand(str(left))
    config = make_config(QUICK, "test")
    made = Synthesiser(named.model).make(model, 2, np.random.default_rng(3), config, batch=10, iterations=36)
    surfaces = Surfaces([tmp_path / "mine"])
    for label in made.labels:
        assert (label.object_id, label.hand) == ("carton", named.model.id)
        assert label.hand.startswith("free_left-") and label.start is not None
        # The vertices of the hulls, which are parts of the skin, are near the box where the label says so.
        R, t = named.model.part_poses(label.T_WH[None], label.hand_pose[None])
        spheres = HandSpheres.of_hand(named.model)
        points_O = (spheres.place(R, t)[0] - label.T_WO[:3, 3]) @ label.T_WO[:3, :3]
        near = surfaces["carton"].near_parts(points_O, spheres.parts)
        assert label.goal_contacts.sum() >= 3 and (near != label.goal_contacts).sum() <= 1


def test_an_object_that_no_hand_spans_is_refused(hand: TorchHand) -> None:
    # A ball of 0.16 m, through which every chord along a normal is as long.
    model = object_model("ball", (Shape("sphere", (0.08,)),), 1.0, True)
    united = body([shape_mesh(shape) for shape in model.shapes])
    ball = Setting(model, united, ObjectField(distance_grid(united, pitch=0.02)))
    with pytest.raises(ConfigError, match="ball: nowhere thinner than 10 cm"):
        propose(hand, ball, np.eye(4)[None], np.random.default_rng(0))


def search(monkeypatch: pytest.MonkeyPatch, hand: TorchHand, setting: Setting, yields: list[int], count: int) -> int:
    """How many rounds are made for `count` labels where they find so many sound grasps, the last number for ever."""
    made: list[int] = []

    def some(*_: object) -> tuple[synthesis._Found, list[None]]:
        n = yields[min(len(made), len(yields) - 1)]
        made.append(n)
        grasps = one_hand(hand, 1.0).take(torch.zeros(n, dtype=torch.long))
        return synthesis._Found(grasps, *(np.zeros((n, 4)) for _ in range(6))), [None] * n

    synthesiser = Synthesiser(free_hand())
    monkeypatch.setattr(synthesiser, "_round", some)
    share = SearchShare(lambda _: None, 1.0, 3 * count, 96, 6, 2)
    parts, starts = synthesiser._search(setting, count, 3 * count, np.random.default_rng(0), 96, 1, share)
    assert len(parts) == len(starts) == sum(made) >= count
    return len(made)


@pytest.mark.parametrize(
    ("yields", "count", "rounds"),
    [
        ([96], 1000, 11),
        ([25], 1000, 40),
        ([40], 25, 2),  # three times as many as asked for
        ([10], 25, 6),  # or else what six rounds find
        ([0, 0, 0, 0, 0, 25], 25, 6),
        ([2, 0, 0], 2, 6),
        ([0, 0, 0, 0, 1, 4, 0, 0, 4, 1, 1, 2, 90], 60, 13),
    ],
)
def test_rounds_go_on_while_they_find_grasps(
    yields: list[int], count: int, rounds: int, hand: TorchHand, setting: Setting, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert search(monkeypatch, hand, setting, yields, count) == rounds


@pytest.mark.parametrize(
    ("yields", "message"),
    [
        ([0, 0, 0, 0, 1, 4, 0, 0, 4, 1, 1, 0, 90], "found 11 sound grasps of 60, next to none in the last 3 rounds"),
        ([0], "found 0 sound grasps of 60, next to none in the last 6 rounds of 96 hands; ask for fewer"),
    ],
)
def test_three_barren_rounds_are_the_end(
    yields: list[int], message: str, hand: TorchHand, setting: Setting, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match=message):
        search(monkeypatch, hand, setting, yields, 60)


def test_more_grasps_than_the_engine_has_worlds_are_tried_in_turns(
    made: synthesis.Synthesised, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, model = make_config(QUICK, "test"), free_object(BRICK, "official", True)
    together = gt_pd_holds(made.labels, free_hand(), model, config)
    sizes: list[int] = []

    def counted(env: GraspEnv, actions: Callable[[], Array]) -> Array:
        sizes.append(env.num_envs)
        return outlasts_window(env, actions)

    monkeypatch.setattr(registry, "AT_ONCE", {config.engine: 2})
    monkeypatch.setattr(synth_trial, "outlasts_window", counted)
    assert gt_pd_holds(made.labels, free_hand(), model, config).tolist() == together.tolist()
    assert sizes == [1, 2]


def test_a_hand_beside_the_object_does_not_hold_it(made: synthesis.Synthesised) -> None:
    label = made.labels[0]
    T = label.T_WH.copy()
    T[2, 3] += 1.0
    far = GraspLabel(**{**vars(label), "T_WH": T})
    config = make_config({"eval": {"window_s": 0.4}}, "test")
    assert not gt_pd_holds([far], free_hand(), free_object(BRICK, "official", True), config).any()
