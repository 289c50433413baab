"""The properties that each method declares, and that the rest of the program follows them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.errors import ConfigError
from dgrasp.eval.motion import check_moves, run_motions
from dgrasp.evaluation import evaluate_choice
from dgrasp.files.paths import cfg_root
from dgrasp.geometry.intersection import Body, body
from dgrasp.methods import BASELINES, METHODS, TRAINED
from dgrasp.methods.flat_rl import FlatRl
from dgrasp.methods.frozen import FrozenGrasp, frozen_grasp
from dgrasp.methods.ik import IkBaseline
from dgrasp.methods.learned_motion import LearnedMotion
from dgrasp.methods.method import Bodies, Method
from dgrasp.methods.pd import PdBaseline
from dgrasp.methods.policy import PolicyMethod
from dgrasp.methods.static_grasp import StaticGrasp
from dgrasp.motion.targets import TargetSet
from dgrasp.pool import PoolSpec
from tests.geometry.solids import box
from tests.methods.test_trained import policy
from tests.scenes import make_spec

CONFIG = load_config(None, ["motion.beta_position=0.5", "motion.ramp_rotation=7", "motion.sigma_position=0.02",
                            "motion.static_fingers=target", "motion.policy=a/b.pt"])  # fmt: skip
BETA = {"position": 0.5, "rotation": 1.0, "ramp_position": 1000, "ramp_rotation": 7}
SIGMA = {"position": 0.02, "rotation": 0.01}
MADE: dict[str, Method] = {
    "policy": PolicyMethod(policy()), "gt_pd": PdBaseline(), "gt_ik": IkBaseline(), "static_grasp": StaticGrasp(),
    "flat_rl": FlatRl(policy()), "learned_motion": LearnedMotion(policy()),
}  # fmt: skip


def test_every_method_is_known_by_the_name_that_it_gives_itself() -> None:
    assert list(METHODS) == list(MADE)
    assert all(kind.name == name and type(MADE[name]) is kind for name, kind in METHODS.items())
    assert BASELINES == ("flat_rl", "gt_ik", "gt_pd", "learned_motion", "static_grasp")
    assert {"grasp": PolicyMethod, "flat": FlatRl, "motion": LearnedMotion} == TRAINED


@pytest.mark.parametrize(("name", "task", "mode", "motion", "takes_policy", "grasps_first"), [
    ("policy", "grasp", "test", "may", "must", True),
    ("gt_pd", "grasp", "label", "never", "no", True),
    ("gt_ik", "grasp", "label", "never", "no", True),
    ("static_grasp", "grasp", "label", "always", "may", True),
    ("flat_rl", "flat", "test", "always", "must", False),
    ("learned_motion", "motion", "test", "always", "must", True),
])  # fmt: skip
def test_what_a_method_is_for(
    name: str, task: str, mode: str, motion: str, takes_policy: str, grasps_first: bool
) -> None:
    made = MADE[name]
    assert (made.task, made.mode, made.motion) == (task, mode, motion)
    assert (made.takes_policy, made.grasps_first) == (takes_policy, grasps_first)
    config = CONFIG.model_copy(update={"env": CONFIG.env.model_copy(update={"task": task})})
    made.check(config)
    other = "flat" if task == "motion" else "motion"
    with pytest.raises(ConfigError, match=f"{name} is for task {task}, but the config has env.task={other}; expected"):
        made.check(config.model_copy(update={"env": config.env.model_copy(update={"task": other})}))
    if motion == "never":
        with pytest.raises(ConfigError, match=f"{name} holds a pose and moves nothing"):
            check_moves(made)
    else:
        check_moves(made)


@pytest.mark.parametrize(("name", "part"), [
    ("policy", {"beta": BETA, "fingers": "policy", "grasp": "policy"}),
    ("static_grasp", {"beta": BETA, "fingers": "target", "grasp": "gt_pd"}),
    ("flat_rl", {"fingers": "policy", "grasp": "flat_rl", "sigma": SIGMA}),
    ("learned_motion", {"fingers": "policy", "grasp": "a/b.pt", "sigma": SIGMA}),
])  # fmt: skip
def test_what_a_result_says_of_a_methods_motion(name: str, part: dict[str, Any]) -> None:
    assert MADE[name].describe(CONFIG.motion) == part
    assert MADE[name].fingers(CONFIG.motion) == part["fingers"]


def test_the_static_grasp_is_as_what_makes_its_grasps() -> None:
    grasps = StaticGrasp(PolicyMethod(policy()))
    assert (grasps.mode, grasps.task, grasps.describe(CONFIG.motion)["grasp"]) == ("test", "grasp", "policy")
    made = StaticGrasp.make(MADE["flat_rl"], "a.pt")
    assert made.task == "flat"
    flat = CONFIG.model_copy(update={"env": CONFIG.env.model_copy(update={"task": "flat"})})
    with pytest.raises(ConfigError, match="a policy of task flat makes no grasp to hold"):
        made.check(flat)


def test_what_a_method_takes_its_policy_from() -> None:
    for name, kind in METHODS.items():
        refused = {"no": [True], "may": [], "must": [False]}[kind.takes_policy]
        for given in (True, False):
            if given not in refused:
                kind.check_policy(given)
                continue
            with pytest.raises(ConfigError) as said:
                kind.check_policy(given)
            own = name in ("flat_rl", "learned_motion")
            assert ("needs a policy trained for it" if own else "what to test: expected one of") in str(said.value)
    assert PolicyMethod.make(MADE["flat_rl"], "a.pt") is MADE["flat_rl"]
    assert FlatRl.make(MADE["flat_rl"], "a.pt") is MADE["flat_rl"]
    command = r"python train.py --cfg cfg/learned_motion.yaml motion.policy=FILE.pt"
    with pytest.raises(ConfigError, match=f"^a.pt: not a policy of learned_motion but one of task flat.*: {command}$"):
        LearnedMotion.make(MADE["flat_rl"], "a.pt")
    assert isinstance(PdBaseline.make(None, ""), PdBaseline) and type(IkBaseline.make(None, "")) is IkBaseline


def test_each_kind_of_policy_is_trained_by_a_config_of_its_task() -> None:
    for task, kind in TRAINED.items():
        assert load_config(cfg_root().parent / kind.cfg).env.task == task
    assert FlatRl.train_command() == "python train.py --cfg cfg/flat_rl.yaml"
    alone = CONFIG.motion.model_copy(update={"stable_alone": False})
    needs = {task: [kind.needs_grasp(motion) for motion in (CONFIG.motion, alone)] for task, kind in TRAINED.items()}
    assert needs == {"grasp": [False, False], "flat": [True, False], "motion": [True, True]}


def test_the_frozen_policy_grasps_for_the_policies_that_see_a_target() -> None:
    spec = dataclasses.replace(make_spec(1, ["env.task=flat"]), grasp=policy(279, actor=279).arrays())
    method, grasping = MADE["flat_rl"].grasping(spec)
    assert isinstance(method, FrozenGrasp) and (method.name, method.mode) == ("policy", "test")
    assert grasping.config.env.task == "grasp" and spec.config.env.task == "flat"
    assert grasping.labels is spec.labels and method.act(np.zeros((2, 279), np.float32)).shape == (2, 51)
    assert frozen_grasp(spec)[1].config == grasping.config
    own = MADE["policy"]
    assert own.grasping(spec) == (own, spec)


def test_only_gt_ik_changes_the_labels(capsys: pytest.CaptureFixture[str]) -> None:
    spec, made = make_spec(2), []

    def bodies() -> dict[str, Body]:
        made.append(1)
        return {"004_sugar_box": body([box((0.06, 0.08, 0.10))])}

    for name, method in MADE.items():
        prepared = method.prepare(spec, bodies)
        assert (prepared is spec) == (name != "gt_ik")
    assert made == [1] and "gt_ik: 2 labels corrected in " in capsys.readouterr().err
    corrected = IkBaseline().prepare(spec, bodies)
    assert corrected.config is spec.config and len(corrected.labels) == 2
    assert not np.array_equal(corrected.labels[0].hand_pose, spec.labels[0].hand_pose)


class Half(PdBaseline):
    """A method defined only here: it takes every second label, holds its fingers still and moves objects."""

    name = "half"
    motion = "may"

    def prepare(self, spec: PoolSpec, bodies: Bodies) -> PoolSpec:
        return dataclasses.replace(spec, labels=spec.labels[::2])

    def fingers(self, motion: Any) -> Any:
        return "target"


def test_a_new_method_needs_nothing_elsewhere() -> None:
    words = ["data=free", "labels.objects=[004_sugar_box]", "labels.limit_per_object=3", "pool.kind=serial",
             "physics.substeps=1", "eval.window_s=0.01", "eval.interpenetration=false"]  # fmt: skip
    config = load_config(None, words)
    choice = resolve(config)
    result, records, spec = evaluate_choice(Half(), config, choice)
    assert result.method == "half" and [r.label for r in records] == list(spec.labels) and len(records) == 2
    assert records[1].label.name == choice.labels.labels[2].name
    moving = make_spec(1, ["motion.steps=2", "motion.stable_alone=false", "pool.kind=serial", "physics.substeps=1"])
    motions = run_motions(moving, Half(), TargetSet("mine", np.eye(4)[None, None], relative=True))
    assert len(motions.records) == 1 and len(motions.records[0].gc) == 2
