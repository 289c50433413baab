"""The authors' published policies, layer by layer against plain numpy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from dgrasp.errors import DataError
from dgrasp.rl.run.published import load_published_actor
from tests.reference import reference_or_skip

_ACTOR = "actor_architecture_state_dict"


@pytest.mark.parametrize("name", ["all_objs/full_6000.pt", "021_bleach_dexycb/full_3000.pt"])
def test_against_plain_numpy(name: str) -> None:
    reference = reference_or_skip()
    path = reference / "policies" / name
    weights = {k: v.numpy() for k, v in torch.load(path, map_location="cpu", weights_only=True)[_ACTOR].items()}
    observation = np.load(reference / "golden" / "observation_reward.npz")["obs"].astype(np.float32)
    hidden = observation.astype(np.float64)
    for layer in (0, 2, 4):
        hidden = hidden @ weights[f"architecture.{layer}.weight"].T + weights[f"architecture.{layer}.bias"]
        if layer < 4:
            hidden = np.where(hidden > 0.0, hidden, 0.01 * hidden)
    policy = load_published_actor(path)
    actions = policy.act(observation)
    assert actions.shape == (120, 51) and actions.dtype == np.float32
    # The policy computes in float64, so the only error is the rounding of the result to float32.
    assert np.allclose(actions, hidden, rtol=2e-7, atol=1e-9)


def _content() -> dict[str, Any]:
    """A small file of the authors' layout: 5 observations, hidden layers of 4 and 3, 2 actions."""
    sizes, layers = (5, 4, 3, 2), (0, 2, 4)
    actor = {}
    for layer, fan_in, fan_out in zip(layers, sizes[:-1], sizes[1:], strict=True):
        actor[f"architecture.{layer}.weight"] = torch.full((fan_out, fan_in), 1.0, dtype=torch.float64)
        actor[f"architecture.{layer}.bias"] = torch.full((fan_out,), -1.0, dtype=torch.float64)
    return {_ACTOR: actor, "actor_distribution_state_dict": {"std": torch.ones(2)}}


def _save(path: Path, content: Any) -> Path:
    torch.save(content, path)
    return path


def test_small_policy_by_hand(tmp_path: Path) -> None:
    # Observation of ones: 5 - 1 = 4; 4 * 4 - 1 = 15; 3 * 15 - 1 = 44.
    # Zeros: -1 -> -0.01; 4 * -0.01 - 1 = -1.04 -> -0.0104; 3 * -0.0104 - 1 = -1.0312.
    policy = load_published_actor(_save(tmp_path / "x.pt", _content()), obs_size=5, action_size=2)
    actions = policy.act(np.array([[1.0] * 5, [0.0] * 5], np.float32))
    assert np.allclose(actions, [[44.0, 44.0], [-1.0312, -1.0312]], rtol=1e-6)


def test_other_sizes_are_refused(tmp_path: Path) -> None:
    path = _save(tmp_path / "x.pt", _content())
    with pytest.raises(DataError, match=r"expected \(4, 279\)"):
        load_published_actor(path)
    with pytest.raises(DataError, match="2 actions; expected 3"):
        load_published_actor(path, obs_size=5, action_size=3)


def test_other_content_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.pt"
    bias = "architecture.2.bias"
    bad: list[Any] = [[1], {}, {_ACTOR: [1]}, {_ACTOR: {}}]
    for value in (torch.zeros(3, 1), torch.zeros(3, dtype=torch.int64), torch.full((3,), float("nan")), "text"):
        content = _content()
        content[_ACTOR][bias] = value
        bad.append(content)
    content = _content()
    content[_ACTOR]["architecture.6.bias"] = torch.zeros(1)
    bad.append(content)
    for content in bad:
        with pytest.raises(DataError, match=r"x\.pt"):
            load_published_actor(_save(path, content), obs_size=5, action_size=2)
    path.write_bytes(b"not torch")
    with pytest.raises(DataError, match="published policy"):
        load_published_actor(path)
    with pytest.raises(DataError, match="cannot read"):
        load_published_actor(tmp_path / "missing.pt")
