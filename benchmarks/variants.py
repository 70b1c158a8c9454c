"""The command line with one change of the recipe that no flag makes: what was tried and not kept.

    python benchmarks/variants.py near-starts train leap --seed 0 --steps 4500000 --out runs/near-starts
    python benchmarks/variants.py near-starts evaluate leap --environment gap --runs runs/near-starts --seed 5

The word before the command names the change; docs/training.md says what came of each.  Those that change
the observation or the networks need `evaluate` under the same name, and a `walk` of their own in the same --out first.
"""

import sys

from agility_ref import networks, observation, policy, ppo
from agility_ref.env import Go1Env
from agility_ref.errors import unknown_name
from agility_ref.observation import SCANDOTS, Mirror

import numpy as np
import torch
from torch import nn

GROWING_STEPS = 2_000_000  # own environment steps until pushes have their full strength
SCANDOT_PAIRS = 1 / 4  # share of the first layer that is for scandots alone


def near_starts() -> None:
    """Start up to 1 m nearer to the first obstacle in training."""
    original = Go1Env._start_pose

    def start_pose(env, n):
        qpos = original(env, n)
        if env.config.stall_seconds:  # which only training has
            qpos[:, 0] += env.rng.uniform(0.0, 1.0, n)
        return qpos

    Go1Env._start_pose = start_pose


def growing_pushes() -> None:
    """Let pushes grow from half to full strength over the first GROWING_STEPS."""
    original = Go1Env._push

    def push(env, direction):
        done = env._clock * env.num_envs / GROWING_STEPS
        original(env, direction * (min(1.0, 0.5 + 0.5 * done) if env.config.stall_seconds else 1.0))

    Go1Env._push = push


def advantages_together() -> None:
    """Normalise the advantages of all kinds of course together."""
    original = ppo.normalize_advantages
    ppo.normalize_advantages = lambda advantages, kinds: original(advantages, np.zeros_like(kinds))


def scandot_encoder() -> None:
    """Give scandots a quarter of the first layer's units for themselves, and the other units the rest of the observation."""
    original = networks.EquivariantMLP.__init__

    def init(net, mirror_in, hidden, mirror_out, last_gain):
        original(net, mirror_in, hidden, mirror_out, last_gain)
        if len(mirror_in.index) != observation.OBS_DIM:
            return
        for layer, basis in zip((net.own[0], net.other[0]), mirror_in.bases(), strict=True):
            scan = torch.from_numpy(np.abs(basis[:, SCANDOTS]).sum(axis=1) > 0)
            mine = torch.arange(layer.out_features) < SCANDOT_PAIRS * layer.out_features
            mask = (mine[:, None] == scan[None]).float()
            with torch.no_grad():
                for units, inputs in ((mine, scan), (~mine, ~scan)):
                    block = torch.empty(int(units.sum()), int(inputs.sum()))
                    nn.init.orthogonal_(block)
                    layer.weight[torch.outer(units, inputs)] = block.flatten()
                layer.weight *= mask
            layer.weight.register_hook(lambda gradient, mask=mask: gradient * mask)

    networks.EquivariantMLP.__init__ = init


def layer_norm() -> None:
    """Bring the units of each hidden layer to mean 0 and variance 1 before their ELU."""

    def forward(net, parts):
        n_even = net.own[0].in_features
        even, odd = parts[:, :n_even], parts[:, n_even:]
        for layer, (w_even, w_odd) in zip(net.own, net.blocks(), strict=True):
            even, odd = nn.functional.linear(even, w_even, layer.bias), nn.functional.linear(odd, w_odd)
            # Over both units of all pairs: mean of e + o and e - o is that of e; their squares sum to 2 (e^2 + o^2).
            even = even - even.mean(-1, keepdim=True)
            scale = torch.rsqrt((even**2).mean(-1, keepdim=True) + (odd**2).mean(-1, keepdim=True) + 1e-5)
            even, odd = even * scale, odd * scale
            u, v = nn.functional.elu(even + odd), nn.functional.elu(even - odd)
            even, odd = (u + v) * networks.SQRT_HALF, (u - v) * networks.SQRT_HALF
        return torch.cat([last(x) for last, x in zip(net.last, (even, odd), strict=False)], -1) @ net.join

    def mlp(x, layers):
        for weight, bias in layers[:-1]:
            x = x @ weight.T + bias
            x = policy.elu((x - x.mean(-1, keepdims=True)) / np.sqrt(x.var(-1, keepdims=True) + 1e-5))
        weight, bias = layers[-1]
        return x @ weight.T + bias

    networks.EquivariantMLP.forward, policy.mlp = forward, mlp


def block_basis() -> None:
    """Let Adam step the blocks W_e and W_o themselves, in place of the weights of the dense layers that they make."""
    networks.EquivariantMLP.blocks = lambda net: ((p.weight, q.weight) for p, q in zip(net.own, net.other, strict=True))


def _sees_more(actor_too: bool) -> None:
    """Show the critic ten numbers beyond the observation, and the actor the first four of them, or none."""
    extra, before = 10, len(observation.OBS_MIRROR.index)
    old = observation.OBS_MIRROR
    observation.OBS_DIM = before + extra
    observation.OBS_MIRROR = Mirror(
        np.append(old.index, before + np.arange(extra)), np.append(old.sign, np.ones(extra, np.float32))
    )
    from agility_ref.training import state

    observe, init, load = Go1Env._observe, networks.ActorCritic.__init__, state._load_network
    even, _ = old.bases()
    first = int((np.count_nonzero(even, axis=1) == 1).sum())  # new even inputs stand behind those without a partner

    def observed(env, ids, noise):
        if not hasattr(env, "conditions"):
            found = np.array([(m.geom_friction[0, 0], m.body("trunk").mass[0]) for m in env.simulation.models])
            env.conditions = (found - found.mean(axis=0)) / (found.std(axis=0) + 1e-6)
        friction, payload = env.conditions[env.course].T
        t, period = env.push_timer * env.config.dt, max(env._push_steps, 1) * env.config.dt  # [s]
        more = np.stack(
            [
                2 * t / period - 1, np.exp(-t / 0.2), np.exp(-t), np.exp(-(period - t) / 0.2),
                2 * env._step_count / env.max_steps - 1, friction, payload,
                (env.world.difficulties[env.course] - 0.5) / 0.3, env.waypoint_index / 4.0 - 1,
                (env._step_count - env._reach_step) * env.config.dt / 5.0,
            ], axis=1, dtype=np.float32,
        )  # fmt: skip
        return np.concatenate([observe(env, ids, noise), more[ids]], axis=1)

    def create(net, *arguments):
        init(net, *arguments)
        hidden = torch.arange(first + 4 * actor_too, first + extra)
        layer = net.actor.own[0]
        layer.weight.data[:, hidden] = 0.0
        layer.weight.register_hook(lambda gradient: gradient.index_fill(1, hidden, 0.0))

    def load_network(learner, arrays):
        arrays = dict(arrays)
        for name in ("net.actor.own.0.weight", "net.critic.own.0.weight"):
            if arrays[name].shape[1] == len(even):  # a warm start that saw less
                arrays[name] = np.insert(arrays[name], [first] * extra, 0.0, axis=1)
        for name, fill in (("normalizer.mean", 0.0), ("normalizer.var", 1.0)):
            if len(arrays[name]) == before:
                arrays[name] = np.append(arrays[name], np.full(extra, fill, np.float32))
        load(learner, arrays)

    Go1Env._observe, networks.ActorCritic.__init__, state._load_network = observed, create, load_network


def critic_sees_more() -> None:
    """Show the critic the time to the next push and since the last, the time left, friction, payload, difficulty and progress."""
    _sees_more(actor_too=False)


def told_of_pushes() -> None:
    """Show the same to the critic, and to the actor when the next push comes: what foresight would be worth."""
    _sees_more(actor_too=True)


VARIANTS = {
    f.__name__.replace("_", "-"): f
    for f in (
        near_starts, growing_pushes, advantages_together, scandot_encoder, layer_norm, block_basis, critic_sees_more,
        told_of_pushes,
    )
}  # fmt: skip


def main(words: list[str]) -> int:
    """Make the change, then run the command; return its exit status."""
    if not words or words[0] not in VARIANTS:
        print(f"variants.py: {unknown_name('variant', words[0] if words else '', VARIANTS)}", file=sys.stderr)
        return 2
    VARIANTS[words[0]]()
    from agility_ref.cli.main import main as command

    sys.argv = [sys.argv[0], *words[1:]]
    return command()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
