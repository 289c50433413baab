"""A trained policy to share: the actor's weights as safetensors, with the config and data of its training.

The format is safetensors because such a file can hold only numbers and text, so an untrusted one is safe to open.
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from dgrasp.errors import DataError
from dgrasp.files.atomic import write_atomic
from dgrasp.rl.networks import Policy, make_mlp
from dgrasp.rl.run.checkpoint import Checkpoint
from dgrasp.rl.run.whole import FORMAT, SCHEMA, damaged_weights, read_description

_SIZES = ("observation_size", "actor_size", "action_size")
_SECTIONS = ("seed", "engine", "physics", "env", "ppo")
"""Sections of the config that the file includes; paths on the machine that trained the policy stay out."""


def write_weights(path: Path, checkpoint: Checkpoint) -> int:
    """Write the policy of a checkpoint and return the file's size in bytes."""
    actor = {name: value.contiguous() for name, value in checkpoint.model.items() if name.startswith("actor.")}
    about = {
        "architecture": checkpoint.architecture,
        "config": {key: checkpoint.config[key] for key in _SECTIONS if key in checkpoint.config},
        "data": checkpoint.data,
        "code": checkpoint.code,
        "epoch": checkpoint.epoch,
    }
    content = save(actor, {"format": FORMAT, "schema": SCHEMA, "about": json.dumps(about, sort_keys=True)})
    write_atomic(path, content)
    return len(content)


def read_weights(path: Path) -> tuple[Policy, dict[str, Any]]:
    """The policy in such a file and the file's description: architecture, config, data, code, epoch.

    Raises `DataError` for a file that is missing, damaged or too large, or that holds something else.
    """
    about = read_description(path)
    try:
        with safe_open(path, "pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (it is no mapping)
    except (SafetensorError, ValueError, OSError) as error:
        raise damaged_weights(path, error) from None
    return _policy(tensors, about, path), about


def _policy(tensors: dict[str, torch.Tensor], about: Any, path: Path) -> Policy:
    observation, actor, action, *hidden = _sizes(about, path)
    layers, expected = [actor, *hidden, action], dict[str, tuple[int, ...]]()
    for i, (fan_in, fan_out) in enumerate(itertools.pairwise(layers)):
        expected |= {f"actor.{2 * i}.weight": (fan_out, fan_in), f"actor.{2 * i}.bias": (fan_out,)}
    if {name: tuple(value.shape) for name, value in tensors.items()} != expected:
        raise DataError(f"{path}: its weights do not match layers of sizes {layers}; take another file")
    if not all(value.dtype == torch.float32 and bool(value.isfinite().all()) for value in tensors.values()):
        raise DataError(f"{path}: a weight is not a finite float32 number; take another file")
    network = make_mlp(layers)
    network.load_state_dict({name.removeprefix("actor."): value for name, value in tensors.items()})
    return Policy(network, observation, action, actor)


def _sizes(about: Any, path: Path) -> list[int]:
    """Sizes of the observation, of its part that the actor sees and of the action, then the hidden layers' widths."""
    try:
        architecture, config = about["architecture"], about["config"]
        sizes = [*(architecture[key] for key in _SIZES), *architecture["hidden"]]
    except (KeyError, TypeError):
        sizes, config = [], None
    if not sizes or not all(type(size) is int and 0 < size <= 65536 for size in sizes) or not isinstance(config, dict):
        raise DataError(f"{path}: it does not describe its weights (architecture and config); take another file")
    return sizes
