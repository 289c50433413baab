"""Losses and the learning rate worked out by hand; the update."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from dgrasp.config.sections import PpoConfig
from dgrasp.errors import DataError
from dgrasp.rl.collect import Trajectories
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.ppo import STATISTICS, Ppo, adapted_learning_rate, gaussian_kl, surrogate_loss, value_loss
from dgrasp.rl.storage import Rollout


def test_surrogate_loss_by_hand() -> None:
    # clip 0.2: the ratio is clamped to 0.8 .. 1.2, and the smaller of the two products counts.
    #   ratio 1.5, A  1:  min( 1.5,  1.2) =  1.2      ratio 1.5, A -1: min(-1.5, -1.2) = -1.5
    #   ratio 0.5, A  1:  min( 0.5,  0.8) =  0.5      ratio 0.5, A -1: min(-0.5, -0.8) = -0.8
    #   ratio 1.1, A  2:  min( 2.2,  2.2) =  2.2
    # mean = (1.2 - 1.5 + 0.5 - 0.8 + 2.2) / 5 = 1.6 / 5 = 0.32
    ratio = torch.tensor([1.5, 1.5, 0.5, 0.5, 1.1])
    advantages = torch.tensor([1.0, -1.0, 1.0, -1.0, 2.0])
    assert float(surrogate_loss(ratio, advantages, 0.2)) == pytest.approx(-0.32, abs=1e-6)


def test_surrogate_loss_has_no_gradient_where_clipped() -> None:
    # d/d ratio of -mean: -A / n where the unclipped product is the smaller one, else 0.
    ratio = torch.tensor([1.5, 1.5, 0.5, 0.5], requires_grad=True)
    surrogate_loss(ratio, torch.tensor([1.0, -1.0, 1.0, -1.0]), 0.2).backward()
    assert ratio.grad is not None and ratio.grad.tolist() == [0.0, 0.25, -0.25, 0.0]


def test_value_loss_by_hand() -> None:
    # clip 0.2, all old values 1:
    #   V 2.0, R 3: (2.0 - 3)^2 = 1      clipped V 1.2: (1.2 - 3)^2 = 3.24    max 3.24
    #   V 1.1, R 0: 1.1^2 = 1.21         clipped V 1.1: 1.21                  max 1.21
    #   V 0.0, R 1: (0 - 1)^2 = 1        clipped V 0.8: 0.04                  max 1
    # clipped mean (3.24 + 1.21 + 1) / 3 = 5.45 / 3; plain mean (1 + 1.21 + 1) / 3 = 1.07
    values, returns = torch.tensor([2.0, 1.1, 0.0]), torch.tensor([3.0, 0.0, 1.0])
    assert float(value_loss(values, torch.ones(3), returns, 0.2)) == pytest.approx(5.45 / 3.0, abs=1e-6)
    assert float(value_loss(values, torch.ones(3), returns, None)) == pytest.approx(1.07, abs=1e-6)


def test_kl_by_hand() -> None:
    # KL(N(0, 1) || N(1, 2)) = ln 2 + (1 + 1) / (2 * 4) - 1/2 = 0.693147 - 0.25; equal normals: exactly 0.
    kl = gaussian_kl(torch.zeros(1, 1), torch.ones(1), torch.ones(1, 1), torch.full((1,), 2.0))
    assert float(kl) == pytest.approx(math.log(2.0) - 0.25, abs=1e-6)
    mean, std = torch.randn(5, 3, generator=torch.Generator().manual_seed(0)), torch.tensor([0.2, 1.0, 3.0])
    assert torch.equal(gaussian_kl(mean, std, mean, std), torch.zeros(5))


def test_kl_agrees_with_torch() -> None:
    generator = torch.Generator().manual_seed(1)
    old_mean, mean = torch.randn(2, 4, 3, generator=generator)
    old_std, std = torch.rand(2, 3, generator=generator) + 0.2
    normal = torch.distributions.Normal
    expected = torch.distributions.kl_divergence(normal(old_mean, old_std), normal(mean, std)).sum(-1)
    assert torch.allclose(gaussian_kl(old_mean, old_std, mean, std), expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("rate", "kl", "expected"),
    [
        (6e-4, 0.021, 4e-4),  # above 2 * 0.01: / 1.5
        (6e-4, 0.004, 9e-4),  # below 0.01 / 2: * 1.5
        (6e-4, 0.02, 6e-4),
        (6e-4, 0.005, 6e-4),
        (6e-4, 0.0, 6e-4),
        (1.2e-5, 1.0, 1e-5),  # 0.8e-5 is below the least rate
        (8e-3, 0.001, 1e-2),  # 1.2e-2 is above the largest
        (6e-4, math.inf, 4e-4),
    ],
)
def test_adapted_learning_rate(rate: float, kl: float, expected: float) -> None:
    assert adapted_learning_rate(rate, kl, PpoConfig()) == pytest.approx(expected, rel=1e-12)


def _setup(seed: int = 0, **changes: Any) -> tuple[Ppo, Rollout]:
    """A model of 4 observations and 2 actions and a rollout of 12 x 4 random samples, rewarded by action 0."""
    config = PpoConfig.model_validate({"hidden": [8], **changes})
    generator = torch.Generator().manual_seed(seed)
    model = ActorCritic(4, 2, config.hidden, config.initial_std, generator)
    rollout = Rollout(torch.device("cpu"))
    t = Trajectories.allocate(12, 4, 4, 2, 1)
    t.observations[:] = torch.randn(12, 4, 4, generator=generator).numpy()
    noise = torch.randn(12, 4, 2, generator=generator)
    t.actions[:] = (model.mean_action(torch.from_numpy(t.observations)) + config.initial_std * noise).numpy()
    t.reward[:] = t.actions[..., 0]
    t.valid[:] = True
    rollout.load(t, model)
    rollout.compute_returns(config.gamma, config.lam)
    return Ppo(model, config), rollout


def test_update_makes_epochs_times_minibatches_steps() -> None:
    ppo, rollout = _setup(update_epochs=3, minibatches=5)
    statistics = ppo.update(rollout, torch.Generator().manual_seed(0))
    assert tuple(statistics) == STATISTICS and all(math.isfinite(value) for value in statistics.values())
    assert {int(state["step"]) for state in ppo.optimizer.state.values()} == {15}


def test_first_step_by_hand() -> None:
    # One step on all samples: the ratio is 1 for all, so the surrogate is -mean of the normalised
    # advantages, 0, and nothing is clipped; the KL is 0. Entropy of two normals with std 1: 2 * 1.418939.
    ppo, rollout = _setup(update_epochs=1, minibatches=1, shuffle=False)
    statistics = ppo.update(rollout, torch.Generator())
    assert statistics["surrogate_loss"] == pytest.approx(0.0, abs=1e-6)
    assert statistics["value_loss"] == pytest.approx(float(rollout.advantages.square().mean()), rel=1e-5)
    assert statistics["kl"] == pytest.approx(0.0, abs=1e-9) and statistics["clip_fraction"] == 0.0
    assert statistics["entropy"] == pytest.approx(2 * 1.418939, abs=1e-5)
    residual, returns = rollout.returns - rollout.values, rollout.returns
    assert statistics["explained_variance"] == pytest.approx(1.0 - float(residual.var() / returns.var()), abs=1e-6)


def test_update_makes_rewarded_actions_likelier() -> None:
    ppo, rollout = _setup(update_epochs=8)
    before = ppo.model.mean_action(rollout.observations.flatten(0, 1)).mean(0)
    ppo.update(rollout, torch.Generator().manual_seed(0))
    after = ppo.model.mean_action(rollout.observations.flatten(0, 1)).mean(0)
    assert after[0] > before[0] + 0.01


def test_std_never_ends_below_the_floor() -> None:
    ppo, rollout = _setup(initial_std=0.21, min_std=0.2, entropy_coefficient=-10.0, adaptive_learning_rate=False)
    ppo.update(rollout, torch.Generator().manual_seed(0))
    # A penalty on entropy lowers every std by about the learning rate (5e-4) at each of 16 steps.
    assert ppo.model.std.min().item() == pytest.approx(0.21 - 16 * 5e-4, abs=5e-4)
    for _ in range(3):
        ppo.update(rollout, torch.Generator().manual_seed(0))
    assert torch.equal(ppo.model.std.detach(), torch.full((2,), 0.2))


def test_std_stays_positive_without_a_floor() -> None:
    # The first step of Adam has the length of the learning rate, here 0.1: it would take 0.01 to -0.09.
    ppo, rollout = _setup(
        initial_std=0.01, min_std=0.0, entropy_coefficient=-10.0, adaptive_learning_rate=False,
        learning_rate=0.1, update_epochs=1, minibatches=1,
    )  # fmt: skip
    ppo.update(rollout, torch.Generator())
    assert 0.0 < ppo.model.std.min().item() <= ppo.model.std.max().item() < 1e-5


def test_fixed_learning_rate_stays() -> None:
    ppo, rollout = _setup(adaptive_learning_rate=False)
    assert ppo.update(rollout, torch.Generator().manual_seed(0))["learning_rate"] == 5e-4


def test_adaptive_learning_rate_moves_within_its_limits() -> None:
    ppo, rollout = _setup(desired_kl=1e-9, min_learning_rate=1e-4)
    assert ppo.update(rollout, torch.Generator().manual_seed(0))["learning_rate"] == 1e-4
    ppo, rollout = _setup(desired_kl=1e9, max_learning_rate=2e-3)
    assert ppo.update(rollout, torch.Generator().manual_seed(0))["learning_rate"] == 2e-3


def test_gradient_is_clipped_to_the_norm() -> None:
    ppo, rollout = _setup(update_epochs=1, minibatches=1, max_grad_norm=0.05)
    norm = ppo.update(rollout, torch.Generator())["grad_norm"]
    left = torch.cat([p.grad.flatten() for p in ppo.model.parameters() if p.grad is not None]).norm()
    assert norm > 0.05 and float(left) == pytest.approx(0.05, rel=1e-3)


def test_in_order_update_needs_no_randomness() -> None:
    results = []
    for seed in (1, 2):
        ppo, rollout = _setup(shuffle=False)
        ppo.update(rollout, torch.Generator().manual_seed(seed))
        results.append(torch.nn.utils.parameters_to_vector(ppo.model.parameters()))
    assert torch.equal(results[0], results[1])


@pytest.mark.parametrize("separate", [False, True])
def test_actor_and_critic_side_by_side_learn_as_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch, separate: bool
) -> None:
    results = []
    for count in (1, 2):
        monkeypatch.setattr("dgrasp.rl.ppo.cores", lambda count=count: count)
        ppo, rollout = _setup(hidden=[128, 128], separate_clipping=separate, max_grad_norm=0.1)
        with ppo._second_thread() as second:
            assert (second is None) == (count == 1)
        statistics = ppo.update(rollout, torch.Generator().manual_seed(0))
        results.append((torch.nn.utils.parameters_to_vector(ppo.model.parameters()).tolist(), statistics))
    assert results[0] == results[1]


def test_an_error_of_the_critic_beside_the_actor_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dgrasp.rl.ppo.cores", lambda: 2)
    ppo, rollout = _setup()
    monkeypatch.setattr(ppo, "_critic_backward", lambda batch: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        ppo.update(rollout, torch.Generator().manual_seed(0))


def test_gradient_that_is_not_finite_is_refused() -> None:
    ppo, rollout = _setup()
    before = torch.nn.utils.parameters_to_vector(ppo.model.parameters()).clone()
    rollout.log_probs[0, 0] = -1e9
    rollout.advantages[0, 0] = -1.0
    with pytest.raises(DataError, match="not finite"):
        ppo.update(rollout, torch.Generator().manual_seed(0))
    assert torch.isfinite(before).all()
    assert torch.isfinite(torch.nn.utils.parameters_to_vector(ppo.model.parameters())).all()


def test_normalised_returns_follow_the_rollouts() -> None:
    ppo, rollout = _setup(normalise_returns=True, update_epochs=1, minibatches=1)
    mean, std = rollout.returns.mean().item(), rollout.returns.std().item()
    before = ppo.model.value(rollout.observations[0]).detach()
    ppo._track_returns(rollout.returns)
    assert ppo.model.return_scale.tolist() == pytest.approx([mean, std], rel=1e-4)
    assert torch.allclose(ppo.model.value(rollout.observations[0]), before, atol=1e-4)
    # Later epochs have a weight of 0.1: mean + 0.1 (10 + mean - mean); the variance does not change.
    ppo._track_returns(rollout.returns + 10.0)
    assert ppo.model.return_scale.tolist() == pytest.approx([mean + 1.0, std], rel=1e-4)


def test_separate_clipping_limits_each_gradient_by_itself() -> None:
    ppo, _ = _setup(separate_clipping=True, max_grad_norm=0.5)
    model = ppo.model
    for parameter in model.parameters():
        parameter.grad = torch.full_like(parameter, 1e-3)
    for parameter in model.critic.parameters():
        parameter.grad = torch.full_like(parameter, 100.0)
    actor = [*model.actor.parameters(), model.std]
    small = math.sqrt(sum(p.grad.square().sum().item() for p in actor))  # type: ignore[union-attr]
    ppo._clip_gradients()
    after = math.sqrt(sum(p.grad.square().sum().item() for p in actor))  # type: ignore[union-attr]
    critic = math.sqrt(sum(p.grad.square().sum().item() for p in model.critic.parameters()))  # type: ignore[union-attr]
    assert after == pytest.approx(small) and critic == pytest.approx(0.5, rel=1e-4)


def test_nothing_of_the_learner_is_on_another_device(monkeypatch: pytest.MonkeyPatch) -> None:
    # Tensors on the meta device have shapes but no numbers. Like those on a GPU, they cannot be mixed with CPU tensors.
    item, cpu = torch.Tensor.item, torch.Tensor.cpu
    on_meta = lambda tensor: tensor.device.type == "meta"  # noqa: E731
    monkeypatch.setattr(torch.Tensor, "item", lambda self: 0.01 if on_meta(self) else item(self))
    monkeypatch.setattr(torch.Tensor, "cpu", lambda self: torch.zeros(self.shape) if on_meta(self) else cpu(self))
    recipes: list[dict[str, Any]] = [
        {}, {"normalise_returns": True, "separate_clipping": True, "advantages_per_minibatch": True},
    ]  # fmt: skip
    for changes in recipes:
        config = PpoConfig.model_validate({"hidden": [8], **changes})
        generator = torch.Generator().manual_seed(0)
        model = ActorCritic(5, 2, config.hidden, config.initial_std, generator, actor_size=4).to("meta")
        t = Trajectories.allocate(12, 4, 5, 2, 1)
        t.valid[:] = True
        t.truncated[-1] = True
        rollout = Rollout(torch.device("meta"))
        rollout.load(t, model)
        rollout.compute_returns(config.gamma, config.lam)
        assert on_meta(rollout.advantages) and on_meta(rollout.returns)
        assert set(Ppo(model, config).update(rollout, generator)) == set(STATISTICS)
        assert all(on_meta(parameter) for parameter in model.parameters())
