from agility_ref.networks import ActorCritic, EquivariantMLP, Normalizer, kl_divergence, sample
from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR, SCANDOT_MIRROR, Mirror
from agility_ref.policy import Policy

import numpy as np
import pytest
import torch
from torch.distributions import Categorical

torch.set_num_threads(1)

PLAIN = Mirror.identity
SWAP = Mirror(np.array([1, 0, 2, 3]), np.array([1, 1, -1, 1], np.float32))  # a pair, one that flips, one that stays
NEGATED = Mirror(np.array([1, 0, 2]), np.array([-1, -1, -1], np.float32))
NETWORKS = {
    "actor": (OBS_MIRROR, ACTION_MIRROR),
    "critic": (OBS_MIRROR, PLAIN(1)),
    "ppo selector": (OBS_MIRROR, PLAIN(5)),
    "supervised selector": (SCANDOT_MIRROR, PLAIN(5)),
    "pairs and signs": (SWAP, NEGATED),
    "no handedness": (PLAIN(7), PLAIN(3)),
}
# An input without handedness has an odd part of length zero.
pytestmark = pytest.mark.filterwarnings("ignore:Initializing zero-element tensors")


def random_network(mirror_in, mirror_out, hidden=(16, 8), seed=0):
    """Weights and biases far from where training starts."""
    torch.manual_seed(seed)
    net = EquivariantMLP(mirror_in, hidden, mirror_out, 1.0)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    return net


def apply(net, x):
    with torch.no_grad():
        return net(net.parts(torch.from_numpy(x))).numpy()


@pytest.fixture(params=NETWORKS.values(), ids=NETWORKS.keys())
def mirrors(request):
    return request.param


@pytest.fixture
def inputs(mirrors):
    return np.random.default_rng(0).standard_normal((50, len(mirrors[0].index))).astype(np.float32)


# --- left and right --------------------------------------------------------------------


@pytest.mark.parametrize("hidden", [(16, 8), (6,), (8, 8, 8)])
def test_the_mirrored_input_gives_the_mirrored_output(mirrors, inputs, hidden):
    net = random_network(*mirrors, hidden)
    output, mirrored = apply(net, inputs), apply(net, mirrors[0](inputs))
    np.testing.assert_allclose(mirrored, mirrors[1](output), atol=1e-5)
    assert output.shape == (50, len(mirrors[1].index)) and (np.ptp(output, axis=0) > 0.1).all()


@pytest.mark.parametrize("outputs", [1, 5])
def test_values_and_choices_do_not_know_left_from_right(outputs):
    x = np.random.default_rng(0).standard_normal((50, len(OBS_MIRROR.index))).astype(np.float32)
    net = random_network(OBS_MIRROR, PLAIN(outputs))
    np.testing.assert_allclose(apply(net, OBS_MIRROR(x)), apply(net, x), atol=1e-5)
    assert np.abs(apply(net, -x) - apply(net, x)).max() > 0.1


def test_dense_layers_are_the_blocks(mirrors, inputs):
    net = random_network(*mirrors)
    n = len(mirrors[0].index)
    arrays = {f"actor.{name}": array for name, array in net.dense().items()}
    arrays |= {"normalizer.mean": np.zeros(n, np.float32), "normalizer.var": np.ones(n, np.float32)}
    policy = Policy.from_arrays(arrays, {})
    assert [weight.shape for weight, _ in policy.layers] == [(16, n), (8, 16), (len(mirrors[1].index), 8)]
    np.testing.assert_allclose(policy(inputs), apply(net, inputs), atol=1e-5)


def test_blocks_take_half_of_the_weights():
    net = EquivariantMLP(OBS_MIRROR, (256, 128), ACTION_MIRROR, 0.01)
    weights = sum(p.numel() for name, p in net.named_parameters() if name.endswith("weight"))
    even, odd = (len(basis) for basis in OBS_MIRROR.bases())
    # Each layer: W_e and W_o between halves.
    assert weights == (even + odd) * 128 + 2 * 128 * 64 + 64 * 12
    dense = sum(array.size for name, array in net.dense().items() if name.endswith("weight"))
    assert weights == dense / 2
    biases = sum(p.numel() for name, p in net.named_parameters() if name.endswith("bias"))
    assert biases == 128 + 64 + 6  # of the even part alone


def test_first_outputs_are_small_and_last_gain_scales_them():
    x = np.random.default_rng(0).standard_normal((100, len(OBS_MIRROR.index))).astype(np.float32)
    outputs = []
    for gain in (0.01, 1.0):
        torch.manual_seed(0)
        outputs.append(apply(EquivariantMLP(OBS_MIRROR, (64, 64), ACTION_MIRROR, gain), x))
    assert 0.0 < np.abs(outputs[0]).max() < 0.2
    np.testing.assert_allclose(100 * outputs[0], outputs[1], rtol=1e-3, atol=1e-5)


def test_blocks_start_orthogonal_without_biases():
    net = EquivariantMLP(SWAP, (8, 8), PLAIN(2), 0.01)
    blocks = [(w, 1.0) for pair in net.blocks() for w in pair] + [(layer.weight, 0.01) for layer in net.last]
    assert len(blocks) == 5
    for weight, gain in blocks:
        w = weight.detach().numpy()
        gram = w @ w.T if len(w) <= w.shape[1] else w.T @ w
        np.testing.assert_allclose(gram, gain**2 * np.eye(len(gram)), atol=1e-5)
    assert all((layer.bias == 0).all() for layer in (*net.own, net.last[0]))
    assert all(layer.bias is None for layer in net.other)


def test_what_is_learned_are_the_weights_of_the_dense_layers(mirrors):
    """Of hidden layers: a step of Adam moves each by the same amount, however little left and right differ."""
    net = random_network(*mirrors)
    n, dense = len(mirrors[0].index), net.dense()
    learned = [
        torch.cat([p.weight, q.weight], 1).abs().sort(1)[0].detach() for p, q in zip(net.own, net.other, strict=True)
    ]
    for i, weights in enumerate(learned):
        rows = np.sort(np.abs(dense[f"{i}.weight"][: len(weights)]), axis=1)
        np.testing.assert_allclose(rows, weights, atol=1e-6)
    assert learned[0].shape[1] == n


# --- distributions ---------------------------------------------------------------------


def test_gaussian_samples_have_the_stated_moments():
    net = ActorCritic(SWAP, PLAIN(3), (8,), init_std=0.5)
    with torch.no_grad():
        outputs = net.actor(net.actor.parts(torch.randn(1, 4))).expand(20_000, 3)
        samples = sample(net.distribution(outputs, net.std()), torch.Generator().manual_seed(0))
    torch.testing.assert_close(samples.mean(0), outputs[0], atol=0.02, rtol=0)
    torch.testing.assert_close(samples.std(0), torch.full((3,), 0.5), atol=0.02, rtol=0)


def test_gaussian_log_prob_of_the_mean():
    # log N(0; 0, 1) = -log(2 pi) / 2 = -0.9189385, twice
    net = ActorCritic(SWAP, PLAIN(2), (8,), init_std=1.0)
    value = net.distribution(torch.zeros(1, 2), net.std()).log_prob(torch.zeros(1, 2))
    assert value.shape == (1,) and value.item() == pytest.approx(2 * -0.9189385, abs=1e-6)


def test_categorical_samples_have_the_stated_frequencies():
    net = ActorCritic(SWAP, PLAIN(4), (8,), init_std=1.0, discrete=True)
    distribution = net.distribution(torch.tensor([[0.0, 1.0, 2.0, -1.0]]).expand(20_000, 4), net.std())
    assert isinstance(distribution, Categorical)
    index = sample(distribution, torch.Generator().manual_seed(0))
    assert index.shape == (20_000,)
    expected = torch.softmax(torch.tensor([0.0, 1.0, 2.0, -1.0]), 0)
    torch.testing.assert_close(torch.bincount(index, minlength=4) / 20_000, expected, atol=0.02, rtol=0)


@pytest.mark.parametrize("discrete", [False, True])
def test_samples_follow_the_generator(discrete):
    net = ActorCritic(SWAP, PLAIN(3), (8,), init_std=1.0, discrete=discrete)
    distribution = net.distribution(torch.zeros(50, 3), net.std().detach())
    a, b, c = (sample(distribution, torch.Generator().manual_seed(seed)) for seed in (0, 0, 1))
    assert torch.equal(a, b) and not torch.equal(a, c)


def test_a_joint_and_its_mirror_image_explore_alike():
    net = ActorCritic(OBS_MIRROR, ACTION_MIRROR, (8,), init_std=0.8)
    assert net.log_std.shape == (6,)
    with torch.no_grad():
        net.log_std += torch.arange(6) * 0.1
    std = net.std().detach().numpy()
    np.testing.assert_array_equal(std, std[ACTION_MIRROR.index])
    assert len(np.unique(std)) == 6
    # A joint's deviation moves with its number, and so does its mirror image's: d std / d log_std = std, twice.
    net.std().sum().backward()
    np.testing.assert_allclose(net.log_std.grad, 2 * net.log_std.detach().exp(), rtol=1e-6)


def test_actions_without_handedness_each_have_their_deviation():
    assert ActorCritic(SWAP, PLAIN(3), (8,), init_std=0.8).log_std.shape == (3,)


# --- network ---------------------------------------------------------------------------


def test_value_is_one_dimensional():
    net = ActorCritic(SWAP, NEGATED, (8, 8), init_std=1.0)
    parts = net.actor.parts(torch.zeros(7, 4))
    assert net.value(parts).shape == (7,)
    assert net.actor(parts).shape == (7, 3)


# --- normaliser ------------------------------------------------------------------------


def test_folded_batches_equal_the_concatenation():
    rng = np.random.default_rng(0)
    batches = [rng.normal(k, k + 1.0, (n, 4)) for k, n in enumerate((5, 1, 300, 17))]
    normalizer = Normalizer(PLAIN(4))
    for batch in batches:
        normalizer.update(batch)
    together = np.concatenate(batches)
    np.testing.assert_allclose(normalizer.mean, together.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(normalizer.var, together.var(axis=0), rtol=1e-5)
    assert normalizer.count == len(together)


@pytest.mark.parametrize("mirror", [SWAP, NEGATED, OBS_MIRROR], ids=["swap", "negated", "observation"])
def test_batches_count_with_their_mirror_images(mirror):
    rng, n = np.random.default_rng(0), len(mirror.index)
    batches = [rng.normal(rng.normal(size=n), 1 + rng.random(n), (size, n)) for size in (5, 300, 17)]
    normalizer = Normalizer(mirror)
    for batch in batches:
        normalizer.update(batch)
    together = np.concatenate(batches)
    together = np.concatenate([together, mirror(together)])
    np.testing.assert_allclose(normalizer.mean, together.mean(axis=0), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(normalizer.var, together.var(axis=0), rtol=1e-4)


def test_normalising_commutes_with_the_mirror():
    rng, n = np.random.default_rng(0), len(OBS_MIRROR.index)
    normalizer = Normalizer(OBS_MIRROR, slice(52, 184), 0.3)
    for _ in range(20):
        normalizer.update(rng.normal(rng.normal(size=n), 1 + rng.random(n), (50, n)))
    np.testing.assert_allclose(OBS_MIRROR(normalizer.mean), normalizer.mean, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(normalizer.var[OBS_MIRROR.index], normalizer.var, rtol=1e-5)
    x = rng.normal(size=(30, n)).astype(np.float32)
    np.testing.assert_allclose(normalizer(OBS_MIRROR(x)), OBS_MIRROR(normalizer(x)), atol=1e-5)


def test_fixed_entries_stay():
    normalizer = Normalizer(PLAIN(6), slice(2, 5), 0.3)
    for _ in range(3):
        normalizer.update(np.random.default_rng(0).normal(9.0, 4.0, (50, 6)))
    np.testing.assert_array_equal(normalizer.mean[2:5], 0.0)
    np.testing.assert_array_equal(normalizer.var[2:5], np.float32(0.09))
    assert (normalizer.mean[[0, 1, 5]] > 5.0).all()


def test_a_new_normaliser_changes_nothing():
    x = np.array([[0.5, -2.0]], np.float32)
    np.testing.assert_allclose(Normalizer(PLAIN(2))(x), x, rtol=1e-6)


def test_normalised_data_is_standard():
    x = np.random.default_rng(0).normal([3.0, -7.0], [0.1, 20.0], (500, 2)).astype(np.float32)
    normalizer = Normalizer(PLAIN(2))
    normalizer.update(x)
    y = normalizer(x)
    assert y.dtype == np.float32
    np.testing.assert_allclose(y.mean(axis=0), 0.0, atol=1e-3)
    np.testing.assert_allclose(y.std(axis=0), 1.0, atol=1e-2)


def test_outliers_are_clipped_at_five():
    np.testing.assert_array_equal(Normalizer(PLAIN(2))(np.array([[1e6, -1e6]], np.float32)), [[5.0, -5.0]])


def test_divergence_of_a_selector_that_is_sure():
    """A skill whose probability rounds to zero: p = (1, 0), q = (1, 0) but for exp(-200) and exp(-300)."""
    old, new = (Categorical(logits=torch.tensor([[0.0, -x]])) for x in (200.0, 300.0))
    assert kl_divergence(old, new).item() == pytest.approx(0.0, abs=1e-6)
    # KL((1/2, 1/2) || (1/4, 3/4)) = log 2 / 2 + log(2/3) / 2
    half, skewed = (Categorical(probs=torch.tensor([[p, 1.0 - p]])) for p in (0.5, 0.25))
    assert kl_divergence(half, skewed).item() == pytest.approx(0.5 * np.log(2.0) + 0.5 * np.log(2.0 / 3.0))
    # where nothing rounds to zero it is PyTorch's
    a, b = (Categorical(logits=torch.tensor(rows)) for rows in ([[0.1, 2.0, -1.0]], [[1.0, 0.0, 0.5]]))
    torch.testing.assert_close(kl_divergence(a, b), torch.distributions.kl_divergence(a, b))
