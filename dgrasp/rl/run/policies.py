"""Read a trained policy from a file of this project or of the authors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dgrasp.hand.store import AUTHORS_HAND
from dgrasp.rl.networks import Policy
from dgrasp.rl.run.checkpoint import load, policy_of, read_torch_file
from dgrasp.rl.run.folder import WEIGHTS_SUFFIX
from dgrasp.rl.run.published import is_published, load_published_actor
from dgrasp.rl.run.weights import read_weights

_AUTHORS_DATA = {"hand": AUTHORS_HAND, "comparable_with_paper": True}
"""What the authors' policies were trained on."""


@dataclass(frozen=True)
class SavedPolicy:
    """A deterministic policy, its training config as plain values, and the record of the data that it was trained on.

    The config is empty for the authors' policies. data: None if it is unknown.
    """

    policy: Policy
    config: dict[str, Any]
    data: dict[str, Any] | None = None

    @property
    def env(self) -> dict[str, Any]:
        """The section `env` of that config."""
        env = self.config.get("env")
        return env if isinstance(env, dict) else {}

    @property
    def objects(self) -> list[str]:
        """The `labels.objects` of that config: the names or sets of the objects; empty for all."""
        labels = self.config.get("labels")
        named = labels.get("objects") if isinstance(labels, dict) else None
        return [str(name) for name in named] if isinstance(named, list) else []

    @property
    def task(self) -> str:
        """The `env.task` that it was trained for."""
        return str(self.env.get("task", "grasp"))


def read_policy(path: Path) -> SavedPolicy:
    """Read this project's checkpoint or weights file, or the authors' checkpoint; `DataError` for other files."""
    if path.suffix == WEIGHTS_SUFFIX:
        policy, about = read_weights(path)
        data = about.get("data")
        return SavedPolicy(policy, about["config"], data if isinstance(data, dict) else None)
    if is_published(read_torch_file(path, "a checkpoint")):
        return SavedPolicy(load_published_actor(path), {}, _AUTHORS_DATA)
    checkpoint = load(path)
    return SavedPolicy(policy_of(checkpoint), checkpoint.config, checkpoint.data)
