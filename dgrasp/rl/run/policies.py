"""A trained policy from a file, whoever wrote it: this project or the authors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dgrasp.rl.networks import Policy
from dgrasp.rl.run.checkpoint import load, policy_of, read_torch_file
from dgrasp.rl.run.folder import WEIGHTS_SUFFIX
from dgrasp.rl.run.published import is_published, load_published_actor
from dgrasp.rl.run.weights import read_weights


@dataclass(frozen=True)
class SavedPolicy:
    """A deterministic policy, and the config that it was trained with as plain values: empty for the authors'."""

    policy: Policy
    config: dict[str, Any]

    @property
    def env(self) -> dict[str, Any]:
        """The section `env` of that config."""
        env = self.config.get("env")
        return env if isinstance(env, dict) else {}

    @property
    def task(self) -> str:
        """The `env.task` that it was trained for."""
        return str(self.env.get("task", "grasp"))


def read_policy(path: Path) -> SavedPolicy:
    """A checkpoint or published weights of ours, or a checkpoint of the authors; `DataError` for anything else."""
    if path.suffix == WEIGHTS_SUFFIX:
        policy, about = read_weights(path)
        return SavedPolicy(policy, about["config"])
    if is_published(read_torch_file(path, "a checkpoint")):
        return SavedPolicy(load_published_actor(path), {})
    checkpoint = load(path)
    return SavedPolicy(policy_of(checkpoint), checkpoint.config)
