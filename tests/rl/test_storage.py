"""Advantages worked out by hand, and the minibatches."""

from __future__ import annotations

import pytest
import torch

from dgrasp.rl.collect import Trajectories
from dgrasp.rl.networks import Density
from dgrasp.rl.storage import Rollout, generalised_advantages

CPU = torch.device("cpu")


class _Model:
    """A model whose value of an observation is the observation itself, and which ignores actions."""

    def density(self, observation: torch.Tensor, action: torch.Tensor) -> Density:
        return Density(torch.zeros(action.shape[:-1]), action, action[0], torch.zeros(()))

    def value(self, observation: torch.Tensor) -> torch.Tensor:
        return observation[..., 0]


def _loaded(steps: int, envs: int) -> Rollout:
    """Zeros."""
    rollout, t = Rollout(CPU), Trajectories.allocate(steps, envs, 1, 1, 1)
    t.valid[:] = True
    rollout.load(t, _Model())  # type: ignore[arg-type]
    rollout.compute_returns(1.0, 1.0)
    return rollout


def test_environments_that_were_lost_are_left_out() -> None:
    # Three environments whose rewards are 1, 2, 3; the second was not collected to the end.
    t = Trajectories.allocate(2, 3, 1, 1, 1)
    t.reward[:] = [1.0, 2.0, 3.0]
    t.last_observation[:, 0] = [10.0, 20.0, 30.0]
    t.valid[:] = [True, False, True]
    rollout = Rollout(CPU)
    rollout.load(t, _Model())  # type: ignore[arg-type]
    rollout.compute_returns(gamma=1.0, lam=1.0)
    # R_1 = r + V(last), R_0 = 2 r + V(last).
    assert rollout.returns.tolist() == [[12.0, 36.0], [11.0, 33.0]]
    assert len(next(rollout.minibatches(1, None)).returns) == 4


def _filled() -> Rollout:
    """Two environments, three steps: step 1 terminates environment 0 and truncates environment 1."""
    rollout = Rollout(CPU)
    t = Trajectories.allocate(3, 2, 1, 1, 1, 2)
    t.reward[:] = [[1.0, 0.0], [2.0, 1.0], [3.0, 2.0]]
    t.observations[..., 0] = [[4.0, 2.0], [1.0, 4.0], [1.0, 0.0]]
    t.terminated[1, 0] = t.truncated[1, 1] = True
    t.last_observation[:, 0] = [6.0, 4.0]
    t.valid[:] = True
    t.final_observations[0, :, 0] = [100.0, 8.0]  # environment 0 has no truncated episode: unused
    rollout.load(t, _Model())  # type: ignore[arg-type]
    return rollout


def test_each_truncated_episode_has_its_own_last_value() -> None:
    t = Trajectories.allocate(5, 1, 1, 1, 1, 2)
    t.truncated[[1, 3], 0] = t.valid[0] = True
    t.final_observations[:, 0, 0] = [7.0, 9.0]
    rollout = Rollout(CPU)
    rollout.load(t, _Model())  # type: ignore[arg-type]
    assert rollout.final_values[[1, 3], 0].tolist() == [7.0, 9.0]


def test_advantages_by_hand() -> None:
    # gamma = lam = 0.5, so gamma lam = 0.25; the values after the last step are 6 and 4.
    # Environment 0, terminated by step 1:
    #   delta_0 = 1 + 0.5 * 1 - 4 = -2.5    delta_1 = 2 + 0 - 1 = 1     delta_2 = 3 + 0.5 * 6 - 1 = 5
    #   A_2 = 5    A_1 = 1 (step 2 is another episode)    A_0 = -2.5 + 0.25 * 1 = -2.25
    # Environment 1, truncated by step 1, where V(final) = 8:
    #   delta_0 = 0 + 0.5 * 4 - 2 = 0    delta_1 = 1 + 0.5 * 8 - 4 = 1    delta_2 = 2 + 0.5 * 4 - 0 = 4
    #   A_2 = 4    A_1 = 1    A_0 = 0 + 0.25 * 1 = 0.25
    rollout = _filled()
    rollout.compute_returns(gamma=0.5, lam=0.5)
    assert rollout.advantages.tolist() == [[-2.25, 0.25], [1.0, 1.0], [5.0, 4.0]]
    # R = A + V.
    assert rollout.returns.tolist() == [[1.75, 2.25], [2.0, 5.0], [6.0, 4.0]]


def test_lambda_one_is_the_discounted_return() -> None:
    # Without ends and with lam = 1: A_0 + V_0 = 1 + 0.9 * 2 + 0.81 * 3 + 0.729 * 10 = 12.52.
    rewards, values = torch.tensor([[1.0], [2.0], [3.0]]), torch.tensor([[7.0], [-2.0], [0.5]])
    next_values = torch.tensor([[-2.0], [0.5], [10.0]])
    advantages = generalised_advantages(rewards, values, next_values, torch.zeros(3, 1, dtype=torch.bool), 0.9, 1.0)
    assert float(advantages[0] + values[0]) == pytest.approx(12.52, abs=1e-5)


def test_lambda_zero_is_the_temporal_difference() -> None:
    # A_0 = 1 + 0.9 * (-2) - 7 = -7.8.
    rewards, values = torch.tensor([[1.0], [2.0]]), torch.tensor([[7.0], [-2.0]])
    next_values = torch.tensor([[-2.0], [0.0]])
    advantages = generalised_advantages(rewards, values, next_values, torch.zeros(2, 1, dtype=torch.bool), 0.9, 0.0)
    assert float(advantages[0]) == pytest.approx(-7.8, abs=1e-6)


@pytest.mark.parametrize("shuffled", [False, True])
def test_minibatches_hold_every_sample_once(shuffled: bool) -> None:
    rollout = _loaded(5, 3)
    rollout.observations[:] = torch.arange(15.0).reshape(5, 3, 1)
    rollout.returns = rollout.observations[..., 0] * 2.0
    generator = torch.Generator().manual_seed(0) if shuffled else None
    batches = list(rollout.minibatches(4, generator))
    assert [len(batch.returns) for batch in batches] == [4, 4, 4, 3]
    seen = torch.cat([batch.observations[:, 0] for batch in batches])
    assert torch.equal(torch.cat([batch.returns for batch in batches]), 2.0 * seen)
    assert sorted(seen.tolist()) == list(range(15))
    assert (seen.tolist() == list(range(15))) is not shuffled


def test_advantages_are_normalised_over_the_whole_rollout() -> None:
    # Advantages 1, 2, 3, 6: mean 3, sample variance (4 + 1 + 0 + 9) / 3 = 14 / 3.
    rollout = _loaded(2, 2)
    rollout.advantages = torch.tensor([[1.0, 2.0], [3.0, 6.0]])
    got = torch.cat([batch.advantages for batch in rollout.minibatches(2, None)])
    expected = torch.tensor([-2.0, -1.0, 0.0, 3.0]) / (14.0 / 3.0) ** 0.5
    assert torch.allclose(got, expected, atol=1e-6)
