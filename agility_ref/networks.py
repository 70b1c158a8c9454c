"""Networks: actor and critic that know left from right, and their observation normaliser.

A Go1 is symmetric: what it does in a situation, its mirror image does mirrored.  Here that holds
by construction, so nothing is learned twice.  The paper's skills and its selector are trained by
"the same PPO formulation" (section 3.2.1), so one class serves both.

In:  normalised observations (n, obs_dim).  Out: distributions over actions, and values.
"""

import itertools
from collections.abc import Iterator

from agility_ref.observation import Mirror
from agility_ref.policy import CLIP, VAR_FLOOR

import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical, Distribution, Independent, Normal

SQRT_HALF = 0.5**0.5


class Normalizer:
    """Running mean and variance per observation entry; part of every checkpoint.

    A batch counts together with its mirror image, so that both are normalised alike.  Entries in
    ``fixed`` keep mean 0 and the standard deviation they are given.  Scandots must: on flat ground
    their variance is next to nothing, and the first pit would then saturate the input.
    """

    def __init__(self, mirror: Mirror, fixed: slice = slice(0, 0), fixed_std: float = 1.0):
        self.mirror, self.count = mirror, 0.0
        self.mean = np.zeros(len(mirror.index), np.float32)
        self.var = np.ones(len(mirror.index), np.float32)
        self.var[fixed] = fixed_std**2
        self._free = np.ones(len(mirror.index), bool)
        self._free[fixed] = False

    def update(self, batch: np.ndarray) -> None:
        """Fold a batch (n, obs_dim) and its mirror image into the statistics."""
        n, mean, var = len(batch), batch.mean(axis=0, dtype=np.float64), batch.var(axis=0, dtype=np.float64)
        # Mean of the two halves; variance within them and between them.
        image = self.mirror(mean)
        var = (var + var[self.mirror.index]) / 2 + ((mean - image) / 2) ** 2
        mean = (mean + image) / 2
        total = self.count + n
        delta = mean - self.mean
        # Chan et al. (1979): M2 = M2_a + M2_b + delta^2 n_a n_b / (n_a + n_b)
        m2 = self.var * self.count + var * n + delta**2 * self.count * n / total
        self.mean[self._free] += (delta * n / total)[self._free]
        self.var[self._free] = (m2 / total)[self._free]
        self.count = total

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return observations normalised and clipped to +-CLIP, float32."""
        return np.clip((observation - self.mean) / np.sqrt(self.var + VAR_FLOOR), -CLIP, CLIP)


class EquivariantMLP(nn.Module):
    """An MLP with f(M x) = M' f(x), exactly, for mirrors M of the input and M' of the output.

    Let E and O be orthonormal bases of what M keeps and flips.  A layer acts on the even part E x
    and on the odd part O x separately, and hidden units come in pairs (u, v) that swap::

        e = E x,   o = O x
        e' = W_e e + b,   o' = W_o o                  each layer; no bias on the odd part
        u = elu(e' + o'),   v = elu(e' - o')          the mirror: o' becomes -o', so u and v swap
        e = (u + v) / sqrt 2,   o = (u - v) / sqrt 2  even and odd again
        f = E'^T (W_e e + b) + O'^T W_o o             the last layer

    An M' that flips nothing makes the network invariant.  The blocks take half of the
    multiplications of dense layers of the same width.  Source: Su et al. 2024, "Leveraging
    Symmetry in RL-based Legged Locomotion Control" (IROS).

    What a hidden layer learns is not W_e and W_o but the weights of the dense layer that they make:
    of a pair of inputs u takes the first by P and its mirror image by Q, and v the other way round::

        W_e = (P + Q) / sqrt 2,   W_o = (P - Q) / sqrt 2

    Adam divides each gradient by its size.  On the nearly flat ground of ``walk`` the odd part of the scandots is
    next to nothing: a W_o of its own would grow on noise alone, and spoil what starts from there (docs/training.md).
    """

    def __init__(self, mirror_in: Mirror, hidden: tuple[int, ...], mirror_out: Mirror, last_gain: float):
        """Draw orthogonal blocks; biases start at zero.

        Parameters
        ----------
        mirror_in, mirror_out : of the input and of the output
        hidden : units of each hidden layer, even numbers
        last_gain : scale of the last layer's weights
        """
        super().__init__()
        bases_in, bases_out = mirror_in.bases(), mirror_out.bases()
        self.register_buffer("split", torch.from_numpy(np.concatenate(bases_in)), persistent=False)
        self.register_buffer("join", torch.from_numpy(np.concatenate(bases_out)), persistent=False)
        halves = [units // 2 for units in hidden]
        n_even, n_odd = ([len(basis), *halves] for basis in bases_in)
        pairs = np.count_nonzero(mirror_in.index > np.arange(len(mirror_in.index)))
        self.pairs = [pairs, *halves[:-1]]  # among the inputs of each hidden layer
        self.own = nn.ModuleList(nn.Linear(*sizes) for sizes in itertools.pairwise(n_even))  # P and b
        self.other = nn.ModuleList(nn.Linear(*sizes, bias=False) for sizes in itertools.pairwise(n_odd))  # Q
        self.last = nn.ModuleList([nn.Linear(n_even[-1], len(bases_out[0]))])  # W_e and b
        if len(bases_out[1]):  # an invariant output has no odd part
            self.last.append(nn.Linear(n_odd[-1], len(bases_out[1]), bias=False))  # W_o
        for layer in (*self.own, *self.other, *self.last):
            nn.init.orthogonal_(layer.weight, last_gain if layer in self.last else 1.0)
        for layer in (*self.own, self.last[0]):
            nn.init.zeros_(layer.bias)
        for p, q, blocks in zip(self.own, self.other, list(self.blocks()), strict=True):
            p.weight.data, q.weight.data = (block.detach() for block in blocks)  # turned twice is as it was

    def blocks(self) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        """Yield W_e and W_o of each hidden layer; where an input has no partner, they are the weights themselves."""
        for p, q, pairs in zip(self.own, self.other, self.pairs, strict=True):
            (p_alone, p), (q_alone, q) = (x.weight.split([x.in_features - pairs, pairs], 1) for x in (p, q))
            yield torch.cat([p_alone, (p + q) * SQRT_HALF], 1), torch.cat([q_alone, (p - q) * SQRT_HALF], 1)

    def parts(self, x: torch.Tensor) -> torch.Tensor:
        """Return [E x, O x], (n, n_in), which :meth:`forward` takes: a rollout makes them once, an update reads them often."""
        return x @ self.split.T

    def forward(self, parts: torch.Tensor) -> torch.Tensor:
        """Map :meth:`parts` of the input to the output, (n, n_in) -> (n, n_out)."""
        even, odd = parts.split([self.own[0].in_features, self.other[0].in_features], 1)
        for layer, (w_even, w_odd) in zip(self.own, self.blocks(), strict=True):
            even, odd = nn.functional.linear(even, w_even, layer.bias), nn.functional.linear(odd, w_odd)
            u, v = nn.functional.elu(even + odd, inplace=True), nn.functional.elu(even - odd, inplace=True)
            even, odd = (u + v) * SQRT_HALF, (u - v) * SQRT_HALF
        return torch.cat([last(x) for last, x in zip(self.last, (even, odd), strict=False)], -1) @ self.join

    @torch.no_grad()
    def dense(self) -> dict[str, np.ndarray]:
        """Multiply out to ordinary layers, "<i>.weight" (out, in) and "<i>.bias" (out,), which any program can run."""
        n_even, layers = self.own[0].in_features, []
        even_in, odd_in = self.split[:n_even], self.split[n_even:]  # how a layer's inputs make its even and odd part
        for layer, (w_even, w_odd) in zip(self.own, self.blocks(), strict=True):
            # u = (W_e E + W_o O) x + b,  v = (W_e E - W_o O) x + b
            even, odd = w_even @ even_in, w_odd @ odd_in
            layers.append((torch.cat([even + odd, even - odd]), torch.cat([layer.bias, layer.bias])))
            eye = torch.eye(layer.out_features) * SQRT_HALF
            even_in, odd_in = torch.cat([eye, eye], 1), torch.cat([eye, -eye], 1)
        n_even = self.last[0].out_features
        weight = self.join[:n_even].T @ self.last[0].weight @ even_in
        for last in self.last[1:]:
            weight += self.join[n_even:].T @ last.weight @ odd_in
        layers.append((weight, self.last[0].bias @ self.join[:n_even]))
        names = [f"{i}.{part}" for i in range(len(layers)) for part in ("weight", "bias")]
        return dict(zip(names, (x.numpy() for layer in layers for x in layer), strict=True))


class ActorCritic(nn.Module):
    """Two separate networks: the actor is equivariant, the critic invariant.

    The actor's output is the mean of a Gaussian over joint targets (skills), or the logits of a
    categorical over skill indices (selectors, ``discrete``).
    """

    def __init__(
        self, obs_mirror: Mirror, act_mirror: Mirror, hidden: tuple[int, ...], init_std: float, discrete: bool = False
    ):
        super().__init__()
        self.discrete = discrete
        # A last layer 100 times smaller starts every policy near the home pose.
        self.actor = EquivariantMLP(obs_mirror, hidden, act_mirror, 0.01)
        self.critic = EquivariantMLP(obs_mirror, hidden, Mirror.identity(1), 1.0)
        # A joint and its mirror image explore alike: one number for both.
        shared = np.unique(np.minimum(act_mirror.index, np.arange(len(act_mirror.index))), return_inverse=True)[1]
        self.register_buffer("shared", torch.from_numpy(shared), persistent=False)
        self.log_std = nn.Parameter(torch.full((int(shared.max()) + 1,), float(np.log(init_std))))

    def std(self) -> torch.Tensor:
        """Return the standard deviation of each action, (act_dim,); the same in every state."""
        return torch.exp(self.log_std)[self.shared]

    def distribution(self, output: torch.Tensor, std: torch.Tensor) -> Distribution:
        """Return the distribution of actions for the actor's output (n, act_dim)."""
        if self.discrete:
            return Categorical(logits=output, validate_args=False)
        return Independent(Normal(output, std, validate_args=False), 1, validate_args=False)

    def value(self, parts: torch.Tensor) -> torch.Tensor:
        """Return V, shape (n,)."""
        return self.critic(parts).squeeze(-1)


def sample(distribution: Distribution, generator: torch.Generator) -> torch.Tensor:
    """Draw actions from a generator of our own, which PyTorch's own sampling does not take."""
    if isinstance(distribution, Categorical):
        return torch.multinomial(distribution.probs, 1, generator=generator).squeeze(-1)
    return distribution.mean + distribution.stddev * torch.randn(distribution.mean.shape, generator=generator)


def kl_divergence(old: Distribution, new: Distribution) -> torch.Tensor:
    """Return KL(old || new), shape (n,); finite where PyTorch's is not.

    A selector that is sure of its skill gives the others probabilities that round to zero, of
    which PyTorch makes an infinite divergence.  Their logarithms are finite.
    """
    if isinstance(old, Categorical):
        # KL = sum_k p_k (log p_k - log q_k)
        return (old.probs * (old.logits - new.logits)).sum(-1)
    return torch.distributions.kl_divergence(old, new)
