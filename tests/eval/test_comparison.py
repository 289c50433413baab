"""When an evaluation is comparable with the paper's numbers, and what is said when it is not."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dgrasp.config.experiment import make_config
from dgrasp.data import DataChoice
from dgrasp.eval import output
from dgrasp.eval.comparison import data_stamp, differences
from dgrasp.eval.summary import summarise
from dgrasp.hand.store import HandSource
from dgrasp.labels.load import LabelSet
from dgrasp.methods import PdBaseline, PolicyMethod, StaticGrasp
from tests.methods.test_trained import policy
from tests.scenes import LAYOUT, free_hand, make_label

PATH = Path("dexycb_train_labels.pkl")
CHOICE = DataChoice(
    root=Path("r"), kind="release", hand_source=HandSource(Path("mano_mean.urdf"), "mano_mean"),
    hand_sha256="0", objects_dir=Path("o"),
    labels=LabelSet([], "mano_mean", LAYOUT.names, "MIT", PATH, "0", ("dexycb", "train"), True), licence="MIT",
    source="dexycb", split="train", inertia="official", differences=(),
)  # fmt: skip
TRAINED = {"hand": "mano_mean", "labels": "dexycb_train_labels.pkl", "split": "train", "inertia": "official",
           "comparable_with_paper": True}  # fmt: skip


SUGAR, CAN = "004_sugar_box", "005_tomato_soup_can"


def with_objects(*names: str) -> DataChoice:
    labels = [make_label(free_hand(), object_id=name) for name in names]
    return replace(CHOICE, labels=replace(CHOICE.labels, labels=labels))


def said(values: dict[str, Any] | None = None, trained: dict[str, Any] | None = None, choice: DataChoice = CHOICE,
         objects: Collection[str] = ()) -> list[str]:
    method = PdBaseline() if trained is None else PolicyMethod(policy(), trained, objects)
    return differences(method, make_config(values or {}), choice)


def test_the_papers_own_tests_are_comparable() -> None:
    for values in ({}, {"eval": {"window_s": 3.87}}, {"motion": {"targets": "easy"}}, {"engine": "mujoco"},
                   {"physics": {"concave": "parts", "preset": "fast"}}, {"labels": {"objects": ["004_sugar_box"]}}):
        assert said(values) == [] == said(values, TRAINED)
    assert "not_comparable" not in data_stamp(PdBaseline(), make_config({}), CHOICE)
    # What a policy was trained on may be unknown.
    assert differences(PolicyMethod(policy()), make_config({}), CHOICE) == []


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"eval": {"window_s": 0.03}}, "the window is 0.03 s, not 5 or 3.87 s"),
        ({"physics": {"masses": "ycb"}}, "physics.masses is ycb, not official"),
        ({"physics": {"friction": 1.0}}, "physics.friction is 1.0, not 0.8"),
        ({"env": {"grasp_steps": 30}}, "env.grasp_steps is 30, not 60"),
        ({"env": {"action": {"kp_rotation": 500.0}}}, "env.action.kp_rotation is 500.0, not 50.0"),
        ({"labels": {"limit_per_object": 2}},
         "labels were left out (labels.limit_per_object=2)"),
        ({"motion": {"targets": "near"}}, "the targets are near, not easy"),
    ],
)
def test_keys_that_are_not_the_papers(values: dict[str, Any], expected: str) -> None:
    assert said(values) == [expected]
    stamp = data_stamp(PdBaseline(), make_config(values), CHOICE)
    assert stamp["comparable_with_paper"] is False and stamp["not_comparable"] == [expected]


@pytest.mark.parametrize(
    ("trained", "expected"),
    [
        ({"hand": "free"}, "the policy was trained for the hand free, not mano_mean"),
        ({"hand": "\x1b[31m" + "x" * 200},
         r"the policy was trained for the hand \x1b[31m" + "x" * 52 + ", not mano_mean"),
        ({"comparable_with_paper": False, "labels": "mine.npz"},
         "the policy was trained on other data than the paper's (labels mine.npz, inertia official)"),
        ({"split": "test", "labels": "dexycb_test_labels.pkl"},
         "the policy was trained on other data than the paper's (labels dexycb_test_labels.pkl, inertia official)"),
        ({"comparable_with_paper": False, "inertia": "true"},
         "the policy was trained on other data than the paper's (labels dexycb_train_labels.pkl, inertia true)"),
    ],
)  # fmt: skip
def test_policies_of_other_hands_and_labels(trained: dict[str, Any], expected: str) -> None:
    assert said(trained=TRAINED | trained) == [expected]
    static = StaticGrasp(PolicyMethod(policy(), TRAINED | trained))
    assert differences(static, make_config({}), CHOICE) == [expected]


def test_other_data_and_then_the_policy() -> None:
    other = replace(CHOICE, differences=("the labels (mine.npz) are not the paper's",))
    assert not other.comparable_with_paper
    assert said(choice=other) == ["the labels (mine.npz) are not the paper's"]
    # The policy's labels matter only where the data could be compared; its hand always does.
    assert said(trained={"hand": "mano_mean", "labels": "mine.npz"}, choice=other) == list(other.differences)
    assert said(trained=TRAINED | {"hand": "claw"}, choice=other)[1] == (
        "the policy was trained for the hand claw, not mano_mean"
    )


def test_the_paper_tests_on_the_objects_that_it_trains_on() -> None:
    for objects in ((), ("004", CAN), ("seen_2",)):
        assert said(trained=TRAINED, choice=with_objects(SUGAR, CAN), objects=objects) == []
    expected = f"the policy was not trained on {CAN}, and the paper has no such test"
    # seen_4 has the sugar box; the paper's fourth set does not have these two.
    for objects in ((SUGAR,), ("my_vase", "3")):
        assert said(trained=TRAINED, choice=with_objects(SUGAR, CAN), objects=objects) == [expected]
    static = StaticGrasp(PolicyMethod(policy(), TRAINED, (SUGAR,)))
    assert differences(static, make_config({}), with_objects(SUGAR, CAN)) == [expected]
    stamp = data_stamp(static, make_config({}), with_objects(SUGAR, CAN))
    assert stamp["not_comparable"] == [expected] and stamp["unseen_objects"] == [CAN]
    assert "unseen_objects" not in data_stamp(PdBaseline(), make_config({}), with_objects(SUGAR, CAN))


def test_the_papers_sets_of_unseen_objects_have_a_table_of_their_own() -> None:
    method = PolicyMethod(policy(), TRAINED, ("seen_1",))
    stamp = data_stamp(method, make_config({}), with_objects(SUGAR, CAN))
    assert stamp["comparable_with_paper"] and stamp["unseen_objects"] == [SUGAR, CAN]
    row = {"index": 0, "success": 1.0}
    result = summarise([{"object": SUGAR, **row}, {"object": CAN, **row}], method="policy", engine="e", window_s=5.0,
                       seed=1, data=stamp, cost={})
    assert result.paper is None and result.correlation_with_paper is None
    assert output.notices(result) == [f"the policy was not trained on {SUGAR}, {CAN}; {output.UNSEEN_TABLE}"]
    # Together with objects that it was trained on, or of another set, it is no test of the paper's.
    for names in ((SUGAR, "025_mug"), ("025_mug", "003_cracker_box")):
        stamp = data_stamp(method, make_config({}), with_objects(*names))
        assert stamp["comparable_with_paper"] is (SUGAR not in names)
