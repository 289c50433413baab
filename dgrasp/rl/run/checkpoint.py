"""Checkpoints of a training run. They are written atomically and read as untrusted input."""

from __future__ import annotations

import contextlib
import copy
import io
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dgrasp.errors import DataError
from dgrasp.files.atomic import TEMPORARY, write_atomic
from dgrasp.rl.networks import ActorCritic, Policy, make_mlp, parameter_shapes
from dgrasp.rl.run.folder import BEST, FOLDER, saved
from dgrasp.rl.run.folder import latest as latest
from dgrasp.rl.run.whole import damaged, read_whole, sealed

SCHEMA = 2
_TYPES: dict[str, tuple[type, ...]] = {
    "epoch": (int,), "model": (dict,), "optimizer": (dict,), "learning_rate": (float,), "architecture": (dict,),
    "config": (dict,), "data": (dict,), "code": (str,), "best_success": (float, type(None)),
}  # fmt: skip


@dataclass(frozen=True)
class Checkpoint:
    """The state of a training run after `epoch` completed epochs.

    A checkpoint needs no random state, because every epoch derives its randomness from (seed, epoch).
    model: state of the `ActorCritic`. optimizer: state of its Adam. config, data: the experiment's config
    and data stamp as plain values. code: version of the package. best_success: best evaluation so far.
    """

    epoch: int
    model: dict[str, Tensor]
    optimizer: dict[str, Any]
    learning_rate: float
    architecture: dict[str, Any]
    config: dict[str, Any]
    data: dict[str, Any]
    code: str
    best_success: float | None


def to_cpu(value: Any) -> Any:
    """A deep copy of nested dictionaries and lists with all tensors on the CPU."""
    if isinstance(value, Tensor):
        return value.detach().cpu().clone()
    if isinstance(value, dict):
        return {key: to_cpu(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_cpu(item) for item in value]
    return value


def save(run_dir: Path, checkpoint: Checkpoint) -> Path:
    """Write `checkpoints/NNNNNN.pt` (NNNNNN: completed epochs) in the run directory and return its path."""
    return _write(run_dir / FOLDER / f"{checkpoint.epoch:06d}.pt", checkpoint)


def save_best(run_dir: Path, checkpoint: Checkpoint) -> Path:
    """Write `best.pt` in the run directory, replacing the previous one."""
    return _write(run_dir / BEST, checkpoint)


def _write(path: Path, checkpoint: Checkpoint) -> Path:
    content = {field.name: getattr(checkpoint, field.name) for field in fields(Checkpoint)}
    stream = io.BytesIO()
    torch.save({"schema": SCHEMA, **content}, stream)
    write_atomic(path, sealed(stream.getvalue()))
    return path


def prune(run_dir: Path, keep: int) -> None:
    """Remove all checkpoints except the newest `keep`, and the half-written files of a killed run."""
    for path in [*saved(run_dir)[:-keep], *(run_dir / FOLDER).glob(TEMPORARY)]:
        with contextlib.suppress(OSError):
            path.unlink()


def read_torch_file(path: Path, what: str) -> Any:
    """The content of a file written by torch.save, with its tensors on the CPU.

    Only tensors and plain values are accepted. Anything else, and a file whose checksums do not match, raises
    `DataError`. what: names the expected content in that error.
    """
    content = read_whole(path, what)
    try:
        return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except Exception as error:  # hostile bytes can raise anything, and every error means the same to the user
        raise damaged(path, what, error) from None


def load(path: Path) -> Checkpoint:
    """Read and check a checkpoint; `DataError` if it is missing, damaged or of another schema version."""
    what = "a checkpoint of this project"
    content = read_torch_file(path, what)
    if not isinstance(content, dict) or "schema" not in content:
        raise DataError(f"{path}: not {what}; expected a dictionary with a schema version")
    schema = content["schema"]
    if type(schema) is not int or schema != SCHEMA:
        raise DataError(
            f"{path}: checkpoint schema {schema!r}; this version of the code reads schema {SCHEMA}. "
            "Use the version of the code that wrote it, or train again"
        )
    for name, types in _TYPES.items():
        if name not in content or not isinstance(content[name], types) or isinstance(content[name], bool):
            expected = " or ".join(t.__name__ for t in types)
            raise DataError(f"{path}: not {what}; expected {name!r} to be of type {expected}")
    checkpoint = Checkpoint(**{name: content[name] for name in _TYPES})
    _check_numbers(checkpoint, path)
    return checkpoint


def _check_numbers(checkpoint: Checkpoint, path: Path) -> None:
    architecture = checkpoint.architecture
    hidden = architecture.get("hidden")
    sizes = [architecture.get(key) for key in ("observation_size", "actor_size", "action_size")]
    sizes += hidden if isinstance(hidden, list) else [None]
    plain = all(isinstance(value, (int, str)) for key, value in architecture.items() if key != "hidden")
    if not plain or not all(type(size) is int and size > 0 for size in sizes):
        raise DataError(f"{path}: malformed architecture {architecture}; expected positive sizes")
    shapes = parameter_shapes(architecture)
    if set(shapes) != set(checkpoint.model):
        raise DataError(f"{path}: the parameters do not match the architecture {architecture}")
    for name, shape in shapes.items():
        _check_tensor(checkpoint.model[name], shape, f"{path}: parameter {name!r}")
    if not bool((checkpoint.model["std"] > 0.0).all() and checkpoint.model["return_scale"][1] > 0.0):
        raise DataError(f"{path}: a standard deviation is not positive")
    if checkpoint.epoch < 0 or not 0.0 < checkpoint.learning_rate < float("inf"):
        raise DataError(f"{path}: epoch {checkpoint.epoch} or learning rate {checkpoint.learning_rate} is invalid")


def _check_tensor(tensor: Any, shape: tuple[int, ...], where: str) -> None:
    ok = isinstance(tensor, Tensor) and tensor.dtype == torch.float32 and tuple(tensor.shape) == shape
    if not ok:
        got = f"{tuple(tensor.shape)} {tensor.dtype}" if isinstance(tensor, Tensor) else type(tensor).__name__
        raise DataError(f"{where} is {got}; expected {shape} torch.float32")
    # An expanded tensor has more elements than the file stores.
    if not tensor.is_contiguous() or not bool(tensor.isfinite().all()):
        raise DataError(f"{where} is not a plain tensor of finite numbers")


def restore(checkpoint: Checkpoint, path: Path, model: ActorCritic, optimizer: torch.optim.Optimizer) -> None:
    """Load a checkpoint into a model and its Adam; `DataError` if it has another architecture."""
    here = model.architecture()
    if checkpoint.architecture != here:
        keys = sorted(set(here) | set(checkpoint.architecture), key=str)
        differ = [
            f"{key} {checkpoint.architecture.get(key)!r} there, {here.get(key)!r} here"
            for key in keys
            if checkpoint.architecture.get(key) != here.get(key)
        ]
        raise DataError(
            f"{path}: the checkpoint has another architecture ({'; '.join(differ)}). "
            "Resume with the config that it was trained with"
        )
    state = _optimizer_state(checkpoint, path, model)
    model.load_state_dict(checkpoint.model)
    groups = copy.deepcopy(optimizer.state_dict()["param_groups"])
    for group in groups:
        group["lr"] = checkpoint.learning_rate
    optimizer.load_state_dict({"state": state, "param_groups": groups})


def _optimizer_state(checkpoint: Checkpoint, path: Path, model: ActorCritic) -> dict[int, Any]:
    """A copy of Adam's state from the checkpoint, checked against the model's parameters."""
    state = checkpoint.optimizer.get("state")
    parameters = list(model.parameters())
    indices = set(range(len(parameters))) if checkpoint.epoch else set()
    if not isinstance(state, dict) or set(state) != indices:
        raise DataError(f"{path}: the state of the optimiser does not match the model")
    for index in indices:
        moments = state[index]
        if not isinstance(moments, dict) or set(moments) != {"step", "exp_avg", "exp_avg_sq"}:
            raise DataError(f"{path}: the state of the optimiser is not Adam's")
        _check_tensor(moments["step"], (), f"{path}: optimiser state {index} 'step'")
        for name in ("exp_avg", "exp_avg_sq"):
            _check_tensor(moments[name], tuple(parameters[index].shape), f"{path}: optimiser state {index} {name!r}")
    return copy.deepcopy(state)


def policy_of(checkpoint: Checkpoint) -> Policy:
    """The deterministic policy of a checkpoint, on the CPU."""
    architecture = checkpoint.architecture
    observation_size, action_size = architecture["observation_size"], architecture["action_size"]
    actor = make_mlp([architecture["actor_size"], *architecture["hidden"], action_size])
    prefix = "actor."
    weights = {name[len(prefix) :]: value for name, value in checkpoint.model.items() if name.startswith(prefix)}
    actor.load_state_dict(weights)
    return Policy(actor, observation_size, action_size, architecture["actor_size"])
