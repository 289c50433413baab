"""The authors' published policies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dgrasp.errors import DataError
from dgrasp.rl.networks import Policy, make_mlp
from dgrasp.rl.run.checkpoint import read_torch_file

_ACTOR = "actor_architecture_state_dict"
_PREFIX = "architecture."
_LAYERS = (0, 2, 4)
_WHAT = "a published policy of the authors (full_NNNN.pt)"


def is_published(content: Any) -> bool:
    """Whether the content returned by `checkpoint.read_torch_file` has the authors' layout."""
    return isinstance(content, dict) and _ACTOR in content


def load_published_actor(path: Path, obs_size: int = 279, action_size: int = 51) -> Policy:
    """The deterministic policy in a file of the authors' release; it computes in float64, as theirs does.

    The file holds three linear layers with LeakyReLU (slope 0.01) between them. Raises `DataError` for any
    other content or other sizes.
    """
    content = read_torch_file(path, _WHAT)
    if not is_published(content) or not isinstance(content[_ACTOR], dict):
        raise DataError(f"{path}: not {_WHAT}; expected a dictionary with {_ACTOR!r}")
    weights: dict[str, Any] = content[_ACTOR]
    names = {f"{_PREFIX}{layer}.{kind}" for layer in _LAYERS for kind in ("weight", "bias")}
    if set(weights) != names:
        raise DataError(f"{path}: the actor has the entries {sorted(map(str, weights))}; expected {sorted(names)}")
    for name, tensor in weights.items():
        _check(tensor, 2 if name.endswith("weight") else 1, f"{path}: {name}")

    sizes = [obs_size, *(len(weights[f"{_PREFIX}{layer}.bias"]) for layer in _LAYERS)]
    for layer, fan_in, fan_out in zip(_LAYERS, sizes[:-1], sizes[1:], strict=True):
        shape = tuple(weights[f"{_PREFIX}{layer}.weight"].shape)
        if shape != (fan_out, fan_in):
            raise DataError(f"{path}: {_PREFIX}{layer}.weight has shape {shape}; expected {(fan_out, fan_in)}")
    if sizes[-1] != action_size:
        raise DataError(f"{path}: the policy has {sizes[-1]} actions; expected {action_size}")

    actor = make_mlp(sizes, dtype=torch.float64)
    actor.load_state_dict({name[len(_PREFIX) :]: tensor.double() for name, tensor in weights.items()})
    return Policy(actor, obs_size, action_size)


def _check(tensor: Any, dimensions: int, where: str) -> None:
    ok = isinstance(tensor, Tensor) and tensor.is_floating_point() and tensor.dim() == dimensions
    if not ok or not tensor.is_contiguous() or not bool(tensor.isfinite().all()):
        raise DataError(f"{where} is not a tensor of finite numbers with {dimensions} dimensions")
