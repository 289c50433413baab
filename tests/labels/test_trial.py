"""The trial of synthesised grasps is the test of the baseline gt_pd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgrasp.build import build_spec
from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.eval.evaluator import evaluate_labels
from dgrasp.eval.metrics import success
from dgrasp.methods.pd import PdBaseline
from dgrasp.synthesis.trial import gt_pd_holds, outlasts_window

WINDOW_S = 0.6
CONFIG = load_config(None, ["data=free", f"eval.window_s={WINDOW_S}", "labels.objects=['061']", "pool.kind=serial",
                            "labels.limit_per_object=8", "physics.preset=fast"])  # fmt: skip


def test_a_trial_succeeds_where_the_test_of_gt_pd_does() -> None:
    spec = build_spec(resolve(CONFIG), CONFIG)
    # One hand is far from its object, whatever the others do.
    T_WH = spec.labels[0].T_WH.copy()
    T_WH[2, 3] += 0.3
    spec = replace(spec, labels=[replace(spec.labels[0], T_WH=T_WH), *spec.labels[1:]])
    (model,) = spec.objects.values()
    held = gt_pd_holds(list(spec.labels), spec.hand, model, CONFIG)
    records, _, _ = evaluate_labels(spec, PdBaseline())
    assert held.tolist() == [success(record, WINDOW_S) for record in records]
    assert not held[0] and held.any()


def test_what_has_fallen_is_not_simulated_further_and_needs_no_new_world() -> None:
    spec = build_spec(resolve(CONFIG), CONFIG)
    T_WH = spec.labels[0].T_WH.copy()
    T_WH[2, 3] += 0.3
    env = GraspEnv([replace(spec.labels[0], T_WH=T_WH)], spec.hand, spec.objects, CONFIG)
    env.reset(0, "label")
    assert outlasts_window(env, lambda: np.zeros((1, 51))).tolist() == [False]
    rebuilt: list[int] = []
    env.worlds.rebuild = rebuilt.append  # type: ignore[method-assign]
    # A fall of 0.25 m takes 8 control steps of 21; the label is a little higher.
    assert env.steps_made[0] < 20 and env.alive.all()
    env.reset(0, "label")
    assert not rebuilt and env.active.all()
    env.close()
