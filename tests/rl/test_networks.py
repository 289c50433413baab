"""Networks: sizes, initialisation, densities, and the actor in numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import nn

from dgrasp.errors import DataError
from dgrasp.rl.networks import ActorCritic, gaussian_log_prob, parameter_shapes


def _model(seed: int = 0) -> ActorCritic:
    return ActorCritic(9, 3, [16, 8], 1.0, torch.Generator().manual_seed(seed))


def test_weights_are_orthogonal_with_gain_sqrt_two_and_biases_zero() -> None:
    model = _model()
    linears = [layer for layer in [*model.actor, *model.critic] if isinstance(layer, nn.Linear)]
    assert len(linears) == 6
    for layer in linears:
        weight = layer.weight.detach()
        gram = weight @ weight.T if weight.shape[0] <= weight.shape[1] else weight.T @ weight
        assert torch.allclose(gram, 2.0 * torch.eye(len(gram)), atol=1e-5)
        assert torch.count_nonzero(layer.bias) == 0
    assert torch.equal(model.std.detach(), torch.ones(3))


def test_activations_are_leaky_rectifiers_between_the_layers_only() -> None:
    kinds = [type(layer) for layer in _model().actor]
    assert kinds == [nn.Linear, nn.LeakyReLU, nn.Linear, nn.LeakyReLU, nn.Linear]


def test_initialisation_follows_the_generator_alone() -> None:
    torch.manual_seed(1)
    before = torch.get_rng_state()
    first = _model().state_dict()
    assert torch.equal(before, torch.get_rng_state())
    torch.manual_seed(2)
    second, other = _model().state_dict(), _model(seed=5).state_dict()
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert not torch.equal(first["actor.0.weight"], other["actor.0.weight"])


def test_parameter_shapes_are_those_of_the_model() -> None:
    model = _model()
    assert parameter_shapes(model.architecture()) == {n: tuple(p.shape) for n, p in model.state_dict().items()}


def test_log_prob_by_hand() -> None:
    # Two actions, std 1 and 2, one standard deviation off each:
    # -1/2 - 1/2 - ln 1 - ln 2 - 2/2 ln(2 pi) = -1 - 0.693147 - 1.837877 = -3.531024.
    got = gaussian_log_prob(torch.tensor([[1.0, -2.0]]), torch.zeros(1, 2), torch.tensor([1.0, 2.0]))
    assert float(got) == pytest.approx(-3.531024, abs=1e-6)


def test_log_prob_and_entropy_agree_with_torch() -> None:
    model = _model()
    with torch.no_grad():
        model.std.copy_(torch.tensor([0.3, 1.0, 2.0]))
    observation = torch.linspace(-1.0, 1.0, 18).reshape(2, 9)
    action = torch.tensor([[0.5, -1.0, 2.0], [0.0, 0.1, -3.0]])
    now = model.density(observation, action)
    normal = torch.distributions.Normal(now.mean, now.std)
    assert torch.allclose(now.log_prob, normal.log_prob(action).sum(-1), atol=1e-5)
    assert torch.allclose(now.entropy, normal.entropy().sum(-1)[0], atol=1e-6)
    assert torch.equal(now.mean, model.mean_action(observation)) and model.value(observation).shape == (2,)


def test_the_actor_in_numpy_is_the_same_policy() -> None:
    model = _model()
    actor = model.actor_arrays(seed=1)
    observation = np.random.default_rng(0).normal(size=(7, 9)).astype(np.float32)
    means = np.empty((7, 3), np.float32)
    actor.means(observation, means)
    assert means == pytest.approx(model.policy().act(observation), abs=1e-6)
    # The result for a row does not depend on the other rows, to the bit.
    for i in range(7):
        alone = np.empty((1, 3), np.float32)
        actor.means(observation[i : i + 1], alone)
        assert np.array_equal(alone[0], means[i])
    # The actor is a copy: the learner's next step does not change it.
    with torch.no_grad():
        model.std.zero_()
    assert actor.std.tolist() == [1.0, 1.0, 1.0]


def test_the_actor_s_noise_is_standard_normal_and_its_own_per_environment_and_epoch() -> None:
    # 195 x 3 x 400 samples: the standard error of mean and standard deviation is below 0.3 %.
    actor = _model().actor_arrays(seed=1)
    noise = np.array([actor.noise(2, index, 195) for index in range(400)])
    assert noise.mean() == pytest.approx(0.0, abs=0.01) and noise.std() == pytest.approx(1.0, abs=0.01)
    assert np.array_equal(noise[5], actor.noise(2, 5, 195))
    streams = [noise[5], noise[6], actor.noise(3, 5, 195), _model().actor_arrays(seed=2).noise(2, 5, 195)]
    assert len({stream.tobytes() for stream in streams}) == 4
    # The environments draw their own noise from default_rng([seed, epoch, index]).
    plain = np.random.default_rng([1, 2, 5]).standard_normal((195, 3), dtype=np.float32)
    assert not np.array_equal(noise[5], plain)


def test_std_floor() -> None:
    model = _model()
    with torch.no_grad():
        model.std.copy_(torch.tensor([-1.0, 0.1, 0.5]))
    model.floor_std(0.2)
    assert model.std.tolist() == pytest.approx([0.2, 0.2, 0.5])


def test_policy_is_the_mean_as_float32_numpy() -> None:
    model = _model()
    observation = np.linspace(-1.0, 1.0, 36, dtype=np.float32).reshape(4, 9)
    observation.flags.writeable = False
    got = model.policy().act(observation)
    assert got.dtype == np.float32 and got.shape == (4, 3)
    assert np.array_equal(got, model.mean_action(torch.tensor(observation)).numpy())


@pytest.mark.parametrize("shape", [(9,), (2, 8), (1, 2, 9)])
def test_policy_refuses_other_observations(shape: tuple[int, ...]) -> None:
    with pytest.raises(DataError, match=r"\(N, 9\), got"):
        _model().policy().act(np.zeros(shape, np.float32))


def test_policy_shares_the_weights() -> None:
    model = _model()
    policy, observation = model.policy(), np.ones((1, 9), np.float32)
    with torch.no_grad():
        model.get_parameter("actor.4.bias").add_(math.pi)
        expected = model.actor(torch.ones(1, 9)).numpy()
    assert np.array_equal(policy.act(observation), expected)


def test_a_new_unit_of_the_returns_leaves_the_values_as_they_are() -> None:
    model = _model()
    observation = torch.linspace(-1.0, 1.0, 18).reshape(2, 9)
    before = model.value(observation).detach()
    model.rescale_returns(torch.tensor(-30.0), torch.tensor(12.0))
    model.rescale_returns(torch.tensor(5.0), torch.tensor(0.5))
    assert torch.allclose(model.value(observation), before, atol=1e-4)
    # The output of the network itself is (V - 5) / 0.5.
    assert torch.allclose(model.critic(observation).squeeze(-1), (before - 5.0) / 0.5, atol=1e-3)


def test_the_actor_does_not_see_what_is_the_critic_s() -> None:
    model = ActorCritic(9, 3, [16], 1.0, torch.Generator().manual_seed(0), actor_size=7, output_gain=0.01)
    observation = torch.linspace(-1.0, 1.0, 18).reshape(2, 9)
    other = observation.clone()
    other[:, 7:] += 1.0
    assert torch.equal(model.mean_action(observation), model.mean_action(other))
    assert not torch.equal(model.value(observation), model.value(other))
    # Some processors round a product differently if the rows of a matrix are not contiguous in memory.
    assert model.policy().act(other.numpy()) == pytest.approx(model.mean_action(observation).numpy(), abs=1e-6)
    means = np.empty((2, 3), np.float32)
    model.actor_arrays(1).means(other.numpy(), means)
    assert means == pytest.approx(model.mean_action(observation).numpy(), abs=1e-6)
    # A last layer of gain 0.01 starts near zero: orthonormal rows times 0.01.
    assert torch.linalg.matrix_norm(model.actor[-1].weight, 2).item() == pytest.approx(0.01, rel=1e-4)
