"""The files that the trained baselines read, and the paper's numbers for them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from dgrasp.config.experiment import load_config
from dgrasp.errors import ConfigError, DataError
from dgrasp.eval.paper import MOTION_OBJECTS, motion_column
from dgrasp.methods import method_of
from dgrasp.methods.flat_rl import FlatRl
from dgrasp.methods.frozen import FrozenGrasp, grasping_policy
from dgrasp.methods.learned_motion import LearnedMotion
from dgrasp.methods.policy import PolicyMethod
from dgrasp.rl.networks import ActorCritic, Policy
from dgrasp.rl.run.policies import SavedPolicy
from tests.reference import reference_or_skip


def policy(observations: int = 9, actions: int = 51, actor: int = 7) -> Policy:
    generator = torch.Generator().manual_seed(0)
    return ActorCritic(observations, actions, [16, 8], 1.0, generator, actor_size=actor).policy()


def test_a_policy_in_plain_numpy_is_the_same_policy() -> None:
    made = policy()
    observation = np.random.default_rng(0).normal(size=(5, 9)).astype(np.float32)
    assert FrozenGrasp(made.arrays()).act(observation) == pytest.approx(made.act(observation), abs=1e-5)
    # The policy does not see the observations that are for the critic only.
    frozen = FrozenGrasp(made.arrays())
    assert np.array_equal(frozen.act(observation[:, :7]), frozen.act(observation))


@pytest.mark.parametrize(("env", "kind"), [
    ({}, PolicyMethod), ({"task": "grasp"}, PolicyMethod), ({"task": "flat"}, FlatRl),
    ({"task": "motion"}, LearnedMotion),
])  # fmt: skip
def test_a_checkpoint_is_what_its_task_makes_it(env: dict[str, str], kind: type[PolicyMethod]) -> None:
    assert type(method_of(SavedPolicy(policy(), {"env": env}))) is kind


def test_a_checkpoint_without_a_task_is_of_grasping_and_an_unknown_task_is_refused() -> None:
    assert SavedPolicy(policy(), {}).task == SavedPolicy(policy(), {"env": None}).task == "grasp"
    with pytest.raises(DataError, match="expected grasp, flat, motion"):
        method_of(SavedPolicy(policy(), {"env": {"task": "dance"}}))


@pytest.mark.parametrize(("method", "mpe", "angle"), [("flat_rl", 0.55, 1.66), ("learned_motion", 0.30, 0.92)])
def test_the_papers_numbers_stand_beside(method: str, mpe: float, angle: float) -> None:
    column = motion_column(method, MOTION_OBJECTS, "easy")
    assert column == {"mpe_m": {"average": mpe}, "geodesic_rad": {"average": angle}}
    assert motion_column(method, MOTION_OBJECTS, "ood") is None


def test_the_authors_policy_can_be_the_frozen_one_with_its_own_features_alone() -> None:
    file = reference_or_skip() / "policies" / "all_objs" / "full_6000.pt"
    config = load_config(None, ["env.task=motion", f"motion.policy={file}"])
    assert grasping_policy(config).arrays().layers[0][0].shape == (128, 279)
    scaled = load_config(None, ["env.task=motion", f"motion.policy={file}", "env.scaled_features=true"])
    with pytest.raises(ConfigError, match=r"env\.scaled_features is False there, True here"):
        grasping_policy(scaled)
