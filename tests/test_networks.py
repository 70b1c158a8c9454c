from agility_ref.networks import (
    ActorCritic,
    Categorical,
    Gaussian,
    Normalizer,
    fit,
    gaussian_entropy,
    gaussian_kl,
    gaussian_log_prob,
    mlp,
)

import numpy as np
import pytest
import torch


@pytest.fixture
def gaussians():
    g = torch.Generator().manual_seed(0)
    mean, other, action = (torch.randn(7, 3, generator=g, dtype=torch.float64) for _ in range(3))
    log_std, other_log_std = (0.5 * torch.randn(3, generator=g, dtype=torch.float64) for _ in range(2))
    return mean, log_std, other, other_log_std, action


def normal(mean, log_std):
    return torch.distributions.Independent(torch.distributions.Normal(mean, log_std.exp()), 1)


@pytest.fixture
def logits():
    g = torch.Generator().manual_seed(1)
    return torch.randn(6, 4, generator=g), torch.randn(6, 4, generator=g)


def log_probabilities(logits):
    return (torch.log_softmax(logits, -1),)


# --- Gaussian --------------------------------------------------------------------------


def test_gaussian_log_prob(gaussians):
    mean, log_std, _, _, action = gaussians
    torch.testing.assert_close(gaussian_log_prob(action, mean, log_std), normal(mean, log_std).log_prob(action))


def test_gaussian_log_prob_of_the_mean():
    # log N(0; 0, 1) = -log(2 pi) / 2 = -0.9189385, twice
    value = gaussian_log_prob(torch.zeros(1, 2), torch.zeros(1, 2), torch.zeros(2))
    assert value.item() == pytest.approx(2 * -0.9189385, abs=1e-6)


def test_gaussian_entropy(gaussians):
    mean, log_std, *_ = gaussians
    torch.testing.assert_close(gaussian_entropy(log_std), normal(mean, log_std).entropy()[0])


def test_gaussian_kl(gaussians):
    mean, log_std, other, other_log_std, _ = gaussians
    expected = torch.distributions.kl_divergence(normal(mean, log_std), normal(other, other_log_std))
    torch.testing.assert_close(gaussian_kl(mean, log_std, other, other_log_std), expected)


def test_gaussian_kl_to_itself_is_zero(gaussians):
    mean, log_std, *_ = gaussians
    torch.testing.assert_close(gaussian_kl(mean, log_std, mean, log_std), torch.zeros(7, dtype=torch.float64))


def test_gaussian_interface_is_the_functions(gaussians):
    mean, log_std, other, other_log_std, action = gaussians
    assert torch.equal(Gaussian.log_prob((mean, log_std), action), gaussian_log_prob(action, mean, log_std))
    assert torch.equal(Gaussian.entropy((mean, log_std)), gaussian_entropy(log_std))
    assert torch.equal(
        Gaussian.kl((mean, log_std), (other, other_log_std)), gaussian_kl(mean, log_std, other, other_log_std)
    )


def test_gaussian_samples_have_the_stated_moments():
    net = ActorCritic(2, 3, (8,), init_std=0.5)
    obs = torch.randn(1, 2).expand(20_000, 2)
    with torch.no_grad():
        mean, log_std = Gaussian.parameters(net, obs)
        samples = Gaussian.sample((mean, log_std), torch.Generator().manual_seed(0))
    torch.testing.assert_close(samples.mean(0), mean[0], atol=0.02, rtol=0)
    torch.testing.assert_close(samples.std(0), torch.full((3,), 0.5), atol=0.02, rtol=0)
    torch.testing.assert_close(log_std.exp(), torch.full((20_000, 3), 0.5))


# --- Categorical -----------------------------------------------------------------------


def test_categorical_log_prob(logits):
    index = torch.tensor([0, 1, 2, 3, 0, 1])
    expected = torch.distributions.Categorical(logits=logits[0]).log_prob(index)
    torch.testing.assert_close(Categorical.log_prob(log_probabilities(logits[0]), index), expected)


def test_categorical_entropy_is_the_mean(logits):
    expected = torch.distributions.Categorical(logits=logits[0]).entropy().mean()
    torch.testing.assert_close(Categorical.entropy(log_probabilities(logits[0])), expected)


def test_categorical_entropy_of_a_fair_die():
    value = Categorical.entropy(log_probabilities(torch.zeros(5, 6)))
    assert value.item() == pytest.approx(np.log(6), abs=1e-6)


def test_categorical_kl(logits):
    p, q = (torch.distributions.Categorical(logits=x) for x in logits)
    kl = Categorical.kl(*(log_probabilities(x) for x in logits))
    torch.testing.assert_close(kl, torch.distributions.kl_divergence(p, q))


def test_categorical_samples_have_the_stated_frequencies():
    net = ActorCritic(2, 4, (8,), init_std=1.0)
    with torch.no_grad():
        net.actor[-1].bias[:] = torch.tensor([0.0, 1.0, 2.0, -1.0])
        obs = torch.zeros(20_000, 2)
        (log_p,) = Categorical.parameters(net, obs)
        index = Categorical.sample((log_p,), torch.Generator().manual_seed(0))
    assert index.shape == (20_000,)
    torch.testing.assert_close(torch.bincount(index, minlength=4) / 20_000, log_p[0].exp(), atol=0.02, rtol=0)


# --- network ---------------------------------------------------------------------------


def test_fit_takes_adams_steps():
    # Adam's first step is the step size times the sign of the gradient: 1 - 0.1, then further down.
    x = torch.nn.Parameter(torch.tensor([1.0]))
    generator = torch.Generator().manual_seed(0)
    assert fit([x], lambda mb: (x**2).sum(), 1, 1, 1, 0.1, generator) == [1.0]
    np.testing.assert_allclose(x.detach(), [0.9], atol=1e-6)


def test_fit_meets_every_state_once_an_epoch_and_averages_over_them():
    seen = []
    x = torch.nn.Parameter(torch.zeros(1))

    def loss(mb):
        seen.append(mb.tolist())
        return mb.float().mean() + 0.0 * x.sum()

    losses = fit([x], loss, 5, 2, 2, 0.1, torch.Generator().manual_seed(0))
    assert [len(mb) for mb in seen] == [2, 2, 1] * 2
    for epoch in (seen[:3], seen[3:]):
        assert sorted(state for mb in epoch for state in mb) == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(losses, [2.0, 2.0])  # (0 + 1 + 2 + 3 + 4) / 5, though batches differ in size


def test_an_annealed_fit_ends_with_small_steps():
    # A constant gradient makes each of Adam's steps the step size: 0.1 (1 + 3/4 + 2/4 + 1/4) = 0.25
    for anneal, expected in ((False, -0.4), (True, -0.25)):
        x = torch.nn.Parameter(torch.zeros(1))
        fit([x], lambda mb, x=x: x.sum(), 4, 1, 1, 0.1, torch.Generator(), anneal)
        np.testing.assert_allclose(x.detach(), [expected], atol=1e-6)


def test_value_is_one_dimensional():
    net = ActorCritic(5, 3, (8, 8), init_std=1.0)
    assert net.value(torch.zeros(7, 5)).shape == (7,)
    assert net.actor(torch.zeros(7, 5)).shape == (7, 3)


def test_first_actions_are_small():
    net = ActorCritic(50, 12, (64, 64), init_std=0.8)
    assert net.actor(torch.randn(100, 50)).abs().max() < 0.2


# --- normaliser ------------------------------------------------------------------------


def test_folded_batches_equal_the_concatenation():
    rng = np.random.default_rng(0)
    batches = [rng.normal(k, k + 1.0, (n, 4)) for k, n in enumerate((5, 1, 300, 17))]
    normalizer = Normalizer(4)
    for batch in batches:
        normalizer.update(batch)
    together = np.concatenate(batches)
    np.testing.assert_allclose(normalizer.mean, together.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(normalizer.var, together.var(axis=0), rtol=1e-5)
    assert normalizer.count == len(together)


def test_fixed_entries_stay():
    normalizer = Normalizer(6, slice(2, 5), 0.3)
    for _ in range(3):
        normalizer.update(np.random.default_rng(0).normal(9.0, 4.0, (50, 6)))
    np.testing.assert_array_equal(normalizer.mean[2:5], 0.0)
    np.testing.assert_array_equal(normalizer.var[2:5], np.float32(0.09))
    assert (normalizer.mean[[0, 1, 5]] > 5.0).all()


def test_a_new_normaliser_changes_nothing():
    x = np.array([[0.5, -2.0]], np.float32)
    np.testing.assert_allclose(Normalizer(2)(x), x, rtol=1e-6)


def test_normalised_data_is_standard():
    x = np.random.default_rng(0).normal([3.0, -7.0], [0.1, 20.0], (500, 2)).astype(np.float32)
    normalizer = Normalizer(2)
    normalizer.update(x)
    y = normalizer(x)
    assert y.dtype == np.float32
    np.testing.assert_allclose(y.mean(axis=0), 0.0, atol=1e-3)
    np.testing.assert_allclose(y.std(axis=0), 1.0, atol=1e-2)


def test_outliers_are_clipped_at_five():
    np.testing.assert_array_equal(Normalizer(2)(np.array([[1e6, -1e6]], np.float32)), [[5.0, -5.0]])


def test_hidden_layers_keep_the_scale():
    first, last = mlp([8, 8, 8], 0.01)[0::2]
    np.testing.assert_allclose((first.weight @ first.weight.T).detach(), 2 * np.eye(8), atol=1e-5)
    np.testing.assert_allclose((last.weight @ last.weight.T).detach(), 1e-4 * np.eye(8), atol=1e-6)
