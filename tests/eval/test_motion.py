"""The experiment of motion synthesis: grasps that it leaves out, its records, and its numbers beside the paper's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgrasp.errors import ConfigError, DataError
from dgrasp.eval import motion as experiment
from dgrasp.eval.motion import ON_FLOOR, check_moves, motion_row, run_motions, until_floor
from dgrasp.eval.output import table_cells, title
from dgrasp.eval.paper import MOTION_OBJECTS, motion_column
from dgrasp.eval.summary import summarise
from dgrasp.methods import METHODS, PdBaseline
from dgrasp.methods.static_grasp import StaticGrasp
from dgrasp.motion.targets import TargetSet
from dgrasp.types import EpisodeRecord
from raisim_like.rotations import transform
from tests.eval.records import at, record
from tests.scenes import make_spec

SHORT = ["env.grasp_steps=3", "env.episode_steps=9", "motion.steps=4", "eval.window_s=0.1", "pool.kind=serial",
         "physics.substeps=2"]  # fmt: skip
DATA = {"comparable_with_paper": True, "source": "dexycb", "split": "train"}
COST = {"control_steps": 1.0, "wall_s": 1.0, "physics_share": 0.5}


def targets(count: int = 2, poses: int = 1) -> TargetSet:
    T = np.tile(np.eye(4), (count, poses, 1, 1))
    T[..., 2, 3] = 0.1 * (1 + np.arange(count))[:, None]
    return TargetSet("mine", T, relative=True)


def moved(height: list[float], start: int = 1, **changes: object) -> EpisodeRecord:
    """An episode whose target is at a height of 1 m, a quarter turn away."""
    made = record(at(height), window_start=start, contacts=np.ones((len(height), 16)))
    goal = transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([0.0, 0, 1]))
    return replace(made, T_WG=np.tile(goal, (len(height), 1, 1)), **changes)


def test_a_row_has_the_last_errors_and_whether_it_was_carried() -> None:
    row = motion_row(moved([0.5, 0.5, 0.7]), 17, follows=False)
    assert row == {"object": "004_sugar_box", "index": 0, "target": 17, "mpe_m": pytest.approx(0.3),
                   "geodesic_rad": pytest.approx(np.pi / 2), "carried": True}
    way = motion_row(moved([0.5, 0.5, 0.7]), 0, follows=True)
    assert way["path_mpe_m"] == pytest.approx(0.4) and way["path_geodesic_rad"] == pytest.approx(np.pi / 2)
    on_table = moved([0.5, 0.5, 0.7], table_contact=np.array([False, False, True]))
    assert not motion_row(on_table, 0, follows=False)["carried"]
    assert not motion_row(moved([0.5, 0.7], contacts=np.zeros((2, 16))), 0, follows=False)["carried"]


def test_a_fall_to_the_floor_ends_the_episode_there() -> None:
    fallen = until_floor(moved([0.5, 0.4, -0.1, -0.9]))
    assert len(fallen.T_WO) == len(fallen.gc) == len(fallen.T_WG) == 3 and fallen.terminated == ON_FLOOR
    row = motion_row(fallen, 0, follows=False)
    assert row["mpe_m"] == pytest.approx(1.1) and not row["carried"] and row["terminated"] == ON_FLOOR
    held = moved([0.5, 0.4])
    assert until_floor(held) is held
    # A height below the floor before the motion begins is ignored.
    assert until_floor(moved([-0.1, 0.4])).terminated == ""


def test_an_episode_that_broke_before_its_motion_has_no_errors() -> None:
    row = motion_row(moved([0.5], start=2, terminated="unstable simulation"), 0, follows=True)
    assert "mpe_m" not in row and "path_mpe_m" not in row and not row["carried"]


def test_grasps_that_fail_the_stability_test_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = make_spec(3, [*SHORT, "motion.per_label=2"])
    verdict = iter([True, False, True])
    monkeypatch.setattr(experiment.metrics, "success", lambda record, window_s: next(verdict))
    said: list[tuple[int, int]] = []
    motions = run_motions(spec, StaticGrasp(), targets(5), lambda done, total: said.append((done, total)))
    assert motions.stable.tolist() == [True, False, True]
    assert [r.label.index for r in motions.records] == [0, 0, 2, 2] and len(motions.targets) == 4
    # Three steps of the test, then two rounds of four; the label's pose needs no grasping phase.
    test = max(1, round(0.1 / spec.config.control_period))
    assert said[-1] == (test + 8, test + 8) and motions.cost["control_steps"] == 3 * test + 2 * 8
    for r, target in zip(motions.records, motions.targets, strict=True):
        assert r.T_WG is not None and len(r.T_WG) == 4 and r.window_start == 0
        assert r.T_WG[-1, 2, 3] == pytest.approx(r.label.T_WO[2, 3] + 0.1 * (1 + target))


def test_nothing_to_move_is_an_error() -> None:
    with pytest.raises(DataError, match="none of the 1 grasps passes"):
        run_motions(make_spec(1, [*SHORT[:-2], "eval.window_s=2.0", "pool.kind=serial"]), StaticGrasp(), targets())


def test_a_path_is_followed_to_its_end_after_the_grasp() -> None:
    class Still(StaticGrasp):
        """Grasps from the approach, with actions of zero."""

        def __init__(self) -> None:
            super().__init__()
            self.mode = "test"

    spec = make_spec(1, [*SHORT, "motion.stable_alone=false"])
    motions = run_motions(spec, Still(), targets(1, poses=6))
    (made,) = motions.records
    assert motions.steps == 6 and made.window_start == 3 and len(made.gc) == 9 and motions.poses_per_target == 6
    assert made.T_WG is not None
    # Until the motion begins, the target is the object's start.
    assert np.allclose(made.T_WG[2, :3, 3], made.label.start.T_WO[:3, 3])  # type: ignore[union-attr]


def test_the_same_in_processes_and_in_one() -> None:
    heights = []
    for kind in ("serial", "process"):
        spec = make_spec(3, [*SHORT, "motion.stable_alone=false", f"pool.kind={kind}", "pool.workers=2"])
        motions = run_motions(spec, StaticGrasp(), targets(3))
        heights.append([np.concatenate([r.gc.ravel(), r.T_WO.ravel(), r.T_WG.ravel()])  # type: ignore[union-attr]
                        for r in motions.records])
    assert np.array_equal(*heights)


def test_beside_the_papers_numbers() -> None:
    rows = [{"object": name, "index": 0, "target": 3, "mpe_m": 0.1, "geodesic_rad": 0.2, "carried": True}
            for name in MOTION_OBJECTS]
    about = {"targets": "easy", "steps": 300, "n_grasps": 8, "left_out": ["a[0]", "b[1]"]}

    def result(method: str, **changes: object):  # type: ignore[no-untyped-def]
        return summarise(rows, method=method, engine="mujoco", window_s=5.0, seed=1, data=DATA, cost=COST,
                         motion={**about, **changes})

    ours = result("policy")
    assert ours.paper == {"mpe_m": {"average": 0.08}, "geodesic_rad": {"average": 0.52}}
    assert ours.correlation_with_paper is None and "target" not in ours.mean_over_labels
    assert ours.as_dict()["motion"]["left_out"] == ["a[0]", "b[1]"]
    assert result("static_grasp").paper["mpe_m"]["average"] == 0.45
    assert result("policy", targets="ood").paper is None
    header, cells = table_cells(ours)
    assert header == ["object", "n", "MPE m", "paper", "geodesic rad", "paper", "carried"]
    assert cells[-2] == ["mean over objects", "6", "0.100", "0.080", "0.20", "0.52", "1.00"]
    assert cells[0][3] == "", "the paper has no numbers per object"
    assert title(ours) == "policy, mujoco, motion: easy, 300 steps, 6 motions of 6 labels"
    assert motion_column("policy", MOTION_OBJECTS[:5], "easy") is None
    assert motion_column("gt_pd", MOTION_OBJECTS, "easy") is None


def test_what_can_move_objects() -> None:
    assert METHODS["static_grasp"] is StaticGrasp
    check_moves(StaticGrasp())
    with pytest.raises(ConfigError, match="gt_pd holds a pose"):
        check_moves(PdBaseline())
