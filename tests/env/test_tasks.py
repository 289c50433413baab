"""The tasks: each is one entry in a registry, from which config, environment and log take what differs."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from dgrasp.config.experiment import load_config
from dgrasp.config.sections import EnvConfig, RewardConfig
from dgrasp.config.tasks import TASKS, Task
from dgrasp.env.features import CRITIC, FULL_STATE, LAYERS, PHI, PSI, FeatureLayer
from dgrasp.env.registry import ENVS
from dgrasp.env.rewards import GROUPS, Reward
from dgrasp.env.target_env import TargetEnv
from dgrasp.errors import ConfigError
from dgrasp.methods import TRAINED
from dgrasp.pool.base import make_env
from dgrasp.pool.serial import SerialPool
from dgrasp.rl.run.log import Log
from tests.scenes import LAYOUT, make_spec

MADE = Task("made", ("psi", "env.features"), ("target",), ("mpe_m", "near"), table_stays=True, given_grasp=True)


def names(task: str, **values: object) -> list[str]:
    layer = FeatureLayer(EnvConfig.model_validate({"task": task, **values}), LAYOUT)
    return [feature.name for feature in layer.features]


def test_every_task_is_whole() -> None:
    assert TASKS.keys() == ENVS.keys() == TRAINED.keys()
    for name, task in TASKS.items():
        assert task.name == name and task.evaluated
        assert set(task.features) <= LAYERS.keys() | {"env.features"} and set(task.rewards) <= GROUPS.keys()


def test_the_features_of_each_task() -> None:
    phi, full, psi = ([feature.name for feature in layer] for layer in (PHI, FULL_STATE, PSI))
    assert names("grasp") == phi and names("motion") == psi and names("flat") == phi + psi
    # The full state has the wrist's and the object's poses already; of the goal-space features none is in psi.
    shared = set(full) & set(psi)
    assert len(shared) == 6 and names("flat", features="full_state") == full + [n for n in psi if n not in shared]
    without = [feature.name for feature in PHI if not feature.is_goal]
    assert names("flat", goal_space=False) == without + psi and names("motion", goal_space=False) == psi
    assert names("motion", critic_features=True) == psi + [feature.name for feature in CRITIC]


def test_the_rewards_of_each_task() -> None:
    grasp = ("position", "pose", "contact", "impulse", "object_velocity", "wrist_linear_velocity",
             "wrist_angular_velocity")
    target = ("target_position", "target_rotation")
    found = {task: Reward(RewardConfig(), LAYOUT, task).names for task in TASKS}
    assert found == {"grasp": grasp, "motion": target, "flat": grasp + target}


def test_a_new_task_is_an_entry_and_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"env.task: expected one of grasp, motion, flat \(got 'made'\)"):
        load_config(None, ["env.task=made"])
    monkeypatch.setitem(TASKS, "made", MADE)
    monkeypatch.setitem(ENVS, "made", TargetEnv)
    with pytest.raises(ConfigError, match="the table stays in task made"):
        load_config(None, ["env.task=made", "env.hold.first_step=45"])
    spec = make_spec(1, ["env.task=made", "env.grasp_steps=3", "env.episode_steps=7"])
    assert spec.config.learned_steps(1) == 4
    env = make_env(spec)
    assert type(env) is TargetEnv and env.reward_terms == ("target_position", "target_rotation")
    assert list(env.layer.slices)[: len(PSI)] == [feature.name for feature in PSI]
    assert list(env.layer.slices)[len(PSI) :] == [feature.name for feature in PHI]
    pool = SerialPool(spec)
    assert (pool.observation_size, pool.action_size) == (env.observation_size, LAYOUT.n_dof)
    pool.close()
    env.close()
    with Log(tmp_path, spec.config, {}, env.reward_terms, lambda epoch: epoch, 1, 0):
        pass
    with open(tmp_path / "progress.csv", encoding="utf-8") as stream:
        columns = next(csv.reader(stream))
    assert {"mpe_m", "near", "target_rotation"} <= set(columns) and "success" not in columns
