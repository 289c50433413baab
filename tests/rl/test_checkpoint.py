"""Checkpoints: a written checkpoint reads back unchanged; anything else is refused."""

from __future__ import annotations

import io
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from dgrasp.errors import DataError
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.run import checkpoint as checkpoints
from dgrasp.rl.run.checkpoint import Checkpoint


def _model(hidden: tuple[int, ...] = (8,), seed: int = 0) -> ActorCritic:
    return ActorCritic(5, 2, list(hidden), 1.0, torch.Generator().manual_seed(seed))


def _trained(seed: int = 0) -> tuple[ActorCritic, torch.optim.Adam]:
    model = _model(seed=seed)
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-4)
    for _ in range(3):
        optimizer.zero_grad()
        now = model.density(torch.ones(4, 5), torch.zeros(4, 2))
        (model.value(torch.ones(4, 5)).sum() - now.log_prob.sum()).backward()
        optimizer.step()
    return model, optimizer


def _checkpoint(epoch: int = 3) -> Checkpoint:
    model, optimizer = _trained()
    return Checkpoint(
        epoch=epoch,
        model=checkpoints.to_cpu(model.state_dict()),
        optimizer=checkpoints.to_cpu(optimizer.state_dict()),
        learning_rate=7e-4,
        architecture=model.architecture(),
        config={"seed": 1, "labels": {"objects": ["a"], "limit_per_object": None}},
        data={"hand": "free", "comparable_with_paper": False},
        code="0.1.0",
        best_success=0.5,
    )


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, torch.Tensor):
        return isinstance(b, torch.Tensor) and a.dtype == b.dtype and torch.equal(a, b)
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(_equal(a[key], b[key]) for key in a)
    return bool(a == b)


def _same(a: Checkpoint, b: Checkpoint) -> bool:
    return all(_equal(getattr(a, field.name), getattr(b, field.name)) for field in fields(Checkpoint))


def _write(path: Path, content: Any) -> Path:
    torch.save(content, path)
    return path


def _content(**changes: Any) -> dict[str, Any]:
    checkpoint = _checkpoint()
    content = {field.name: getattr(checkpoint, field.name) for field in fields(Checkpoint)}
    return {"schema": checkpoints.SCHEMA, **content, **changes}


def test_round_trip(tmp_path: Path) -> None:
    path = checkpoints.save(tmp_path, _checkpoint())
    assert path == tmp_path / "checkpoints" / "000003.pt"
    assert _same(checkpoints.load(path), _checkpoint())
    assert [p.name for p in path.parent.iterdir()] == ["000003.pt"]


def test_restore_gives_model_and_optimizer_back(tmp_path: Path) -> None:
    path = checkpoints.save(tmp_path, _checkpoint())
    trained, reference = _trained()
    model = _model(seed=9)
    optimizer = torch.optim.Adam(model.parameters(), lr=1.0)
    checkpoints.restore(checkpoints.load(path), path, model, optimizer)
    assert _equal(model.state_dict(), trained.state_dict())
    assert _equal(optimizer.state_dict()["state"], reference.state_dict()["state"])
    assert optimizer.param_groups[0]["lr"] == 7e-4


def test_loaded_policy_is_the_mean(tmp_path: Path) -> None:
    path = checkpoints.save(tmp_path, _checkpoint())
    model, _ = _trained()
    observation = np.linspace(-1.0, 1.0, 15, dtype=np.float32).reshape(3, 5)
    policy = checkpoints.policy_of(checkpoints.load(path))
    assert np.array_equal(policy.act(observation), model.policy().act(observation))


def test_latest_and_prune_go_by_epoch(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no checkpoint there"):
        checkpoints.latest(tmp_path)
    for epoch in (2, 10, 9, 100):
        checkpoints.save(tmp_path, _checkpoint(epoch))
    folder = tmp_path / "checkpoints"
    (folder / "notes.pt").write_text("a user's own")
    (folder / ".000011.pt.x1y2.tmp").write_text("left by a killed run")
    assert checkpoints.latest(tmp_path).name == "000100.pt"
    checkpoints.prune(tmp_path, keep=2)
    assert sorted(p.name for p in folder.iterdir()) == ["000010.pt", "000100.pt", "notes.pt"]


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("a file where the folder should be")
    with pytest.raises(DataError, match="cannot be written"):
        checkpoints.save(tmp_path / "run", _checkpoint())


def test_another_architecture_is_refused(tmp_path: Path) -> None:
    path = checkpoints.save(tmp_path, _checkpoint())
    model = _model(hidden=(16, 8))
    with pytest.raises(DataError, match=r"another architecture \(hidden \[8\] there, \[16, 8\] here\)"):
        checkpoints.restore(checkpoints.load(path), path, model, torch.optim.Adam(model.parameters()))


@pytest.mark.parametrize("schema", [0, 1, 3, "2", True, 1.0, None, torch.ones(2)])
def test_another_schema_is_refused(tmp_path: Path, schema: Any) -> None:
    with pytest.raises(DataError, match="schema"):
        checkpoints.load(_write(tmp_path / "x.pt", _content(schema=schema)))


def test_truncated_or_extended_file_is_refused(tmp_path: Path) -> None:
    whole = checkpoints.save(tmp_path, _checkpoint()).read_bytes()
    path = tmp_path / "changed.pt"
    for size in [0, 1, 100, len(whole) // 2, *range(len(whole) - 200, len(whole))]:
        path.write_bytes(whole[:size])
        with pytest.raises(DataError, match="damaged"):
            checkpoints.load(path)
    path.write_bytes(whole + b"x")
    with pytest.raises(DataError, match="damaged"):
        checkpoints.load(path)


def test_a_changed_byte_is_noticed(tmp_path: Path) -> None:
    whole = checkpoints.save(tmp_path, _checkpoint()).read_bytes()
    path, rng = tmp_path / "changed.pt", np.random.default_rng(0)
    body = len(whole) - len(b"dgrasp sha256 ") - 64
    for at in [0, body - 1, *rng.integers(0, body, 200)]:
        changed = bytearray(whole)
        changed[at] ^= int(rng.integers(1, 256))
        path.write_bytes(changed)
        with pytest.raises(DataError, match="damaged"):
            checkpoints.load(path)


def test_without_the_seal_the_checksums_of_the_archive_count(tmp_path: Path) -> None:
    path, content = tmp_path / "x.pt", _content()
    assert _same(checkpoints.load(_write(path, content)), _checkpoint())
    whole = path.read_bytes()
    weights = content["model"]["actor.0.weight"].numpy().tobytes()
    start = whole.index(weights)
    for at in range(start, start + len(weights), 7):
        changed = bytearray(whole)
        changed[at] ^= 1
        path.write_bytes(changed)
        with pytest.raises(DataError, match="damaged"):
            checkpoints.load(path)


def test_others_can_read_a_checkpoint(tmp_path: Path) -> None:
    content = torch.load(checkpoints.save(tmp_path, _checkpoint()), weights_only=True)
    assert content["epoch"] == 3 and content["schema"] == 2


class _Evil:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.path,))


def test_code_in_a_file_does_not_run(tmp_path: Path) -> None:
    path = _write(tmp_path / "x.pt", _content(config={"evil": _Evil(tmp_path / "ran")}))
    with pytest.raises(DataError, match="damaged or not"):
        checkpoints.load(path)
    assert not (tmp_path / "ran").exists()


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot read"):
        checkpoints.load(tmp_path / "missing.pt")
    with pytest.raises(DataError, match="cannot read"):
        checkpoints.load(tmp_path)
    path = tmp_path / "x.pt"
    stream = io.BytesIO()
    np.savez_compressed(stream, a=np.zeros(3))
    for content in (b"hello", stream.getvalue()):
        path.write_bytes(content)
        with pytest.raises(DataError, match="damaged or not"):
            checkpoints.load(path)
    for value in ([1, 2], {"model": 1}, torch.zeros(3)):
        with pytest.raises(DataError, match="not a checkpoint of this project"):
            checkpoints.load(_write(path, value))


@pytest.mark.parametrize(
    "changes",
    [
        {"epoch": -1},
        {"epoch": True},
        {"epoch": "3"},
        {"learning_rate": float("nan")},
        {"learning_rate": 0.0},
        {"model": {}},
        {"model": [1]},
        {"config": None},
        {"best_success": "high"},
        {"architecture": {}},
        {"architecture": {**_model().architecture(), "hidden": [2**40]}},
        {"architecture": {**_model().architecture(), "hidden": ["8"]}},
        {"architecture": {**_model().architecture(), "std": torch.ones(2)}},
        {"architecture": {**_model().architecture(), "observation_size": -5}},
    ],
)
def test_malformed_entries_are_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    with pytest.raises(DataError, match=r"x\.pt"):
        checkpoints.load(_write(tmp_path / "x.pt", _content(**changes)))


@pytest.mark.parametrize(
    ("name", "tensor"),
    [
        ("std", torch.tensor([1.0, float("nan")])),
        ("std", torch.tensor([1.0, 0.0])),
        ("std", torch.ones(3)),
        ("actor.0.bias", torch.zeros(8, dtype=torch.float64)),
        ("actor.0.weight", torch.zeros(1, 1).expand(8, 5)),
        ("critic.2.bias", [0.0]),
    ],
)
def test_malformed_parameters_are_refused(tmp_path: Path, name: str, tensor: Any) -> None:
    model = {**_checkpoint().model, name: tensor}
    with pytest.raises(DataError, match=r"x\.pt"):
        checkpoints.load(_write(tmp_path / "x.pt", _content(model=model)))


@pytest.mark.parametrize("change", ["missing", "shape", "name", "kind", "list"])
def test_malformed_optimizer_is_refused(change: str) -> None:
    checkpoint = _checkpoint()
    state = checkpoint.optimizer["state"]
    if change == "missing":
        del state[0]
    elif change == "shape":
        state[0]["exp_avg"] = torch.zeros(99)
    elif change == "name":
        state[0] = {"step": torch.tensor(1.0)}
    elif change == "kind":
        state[0]["step"] = 1
    else:
        checkpoint = replace(checkpoint, optimizer={"state": [1]})
    model = _model(seed=4)
    before = checkpoints.to_cpu(model.state_dict())
    with pytest.raises(DataError, match="optimiser"):
        checkpoints.restore(checkpoint, Path("x.pt"), model, torch.optim.Adam(model.parameters()))
    assert _equal(model.state_dict(), before)
