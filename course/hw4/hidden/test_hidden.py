"""Hidden tests: equivariance exactly, the robot's own legs, and properties of the frontier."""

from agility_ref.go1 import DEFAULT_DOF_POS, make_model
from agility_ref.terrain import make_course

import adapters
import mujoco
import numpy as np
import pytest
import torch

PARTS, LEGS = ("hip", "thigh", "calf"), ("FL", "FR", "RL", "RR")


def mirror(rng, n):
    """A random signed permutation that is its own inverse, with at least one swap, a kept and a flipped entry."""
    order = rng.permutation(n)
    p = torch.zeros(n, n)
    p[order[0], order[0]], p[order[1], order[1]] = 1.0, -1.0
    rest = order[2:]
    for a, b in zip(rest[::2], rest[1::2], strict=False):
        p[a, b] = p[b, a] = float(rng.choice([-1.0, 1.0]))
    if len(rest) % 2:
        p[rest[-1], rest[-1]] = 1.0
    return p


def mirrors(seed, n_in=7, n_out=6):
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    return mirror(rng, n_in), mirror(rng, n_out)


def check(net, p_in, p_out, when):
    x = torch.randn(40, len(p_in))
    error = (net(x @ p_in) - net(x) @ p_out).abs().max()
    assert error < 1e-4, f"{when}: f(P x) and P f(x) differ by up to {error:.3g}"


def shake(net):
    """Give every parameter an arbitrary value."""
    assert list(net.parameters()), "the layer has no parameters that an optimiser could change"
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.copy_(torch.randn_like(parameter))


def test_joint_mirror_of_the_robot(seed):
    """A mirrored pose puts the feet of MuJoCo's Go1 where their mirror images are."""
    model = make_model(make_course("walk", 0.0))
    data = mujoco.MjData(model)

    def feet(q):
        data.qpos[:7] = (0, 0, 1, 1, 0, 0, 0)
        for k, angle in enumerate(q):
            address = model.joint(f"{LEGS[k % 4]}_{PARTS[k // 4]}").qposadr[0]
            data.qpos[address] = DEFAULT_DOF_POS[address - 7] + angle
        mujoco.mj_kinematics(model, data)
        return np.array([data.site(f"{leg}_foot").xpos for leg in LEGS])

    q = np.random.default_rng(seed).uniform(-0.3, 0.3, 12)
    got = feet(adapters.joint_mirror().double().numpy() @ q)
    expected = feet(q)[[1, 0, 3, 2]] * (1, -1, 1)
    error = np.abs(got - expected).max()
    assert error < 1e-6, f"in the mirrored pose a foot of the Go1 is {error:.3f} m from where its mirror image is"


def test_symmetric_part_is_a_projection(seed):
    p_in, p_out = mirrors(seed)
    weight = torch.randn(6, 7)
    part = adapters.symmetric_part(weight, p_in, p_out)
    assert torch.allclose(p_out @ part, part @ p_in, atol=1e-5), (
        "P_out W and W P_in differ: the result is not equivariant"
    )
    again = adapters.symmetric_part(part, p_in, p_out)
    assert torch.allclose(again, part, atol=1e-5), (
        "what is symmetric already must stay as it is: are the two halves averaged?"
    )
    left = weight - part
    assert abs((left * part).sum()) < 1e-4, (
        "what is taken away is orthogonal to what stays: that makes it the nearest one"
    )


def test_layer_is_equivariant(seed):
    p_in, p_out = mirrors(seed)
    layer = adapters.EquivariantLinear(p_in, p_out)
    check(layer, p_in, p_out, "a new layer")
    shake(layer)
    check(layer, p_in, p_out, "a layer with arbitrary parameters, the bias too")


def test_layer_starts_well(seed):
    p_in, p_out = mirrors(seed, 60, 80)
    variance = adapters.EquivariantLinear(p_in, p_out)(torch.randn(500, 60)).var()
    assert 0.1 < variance < 3, f"inputs of variance 1 leave a new layer with a variance of {variance:.3g}"


def test_layer_learns_every_equivariant_map(seed):
    p_in, p_out = mirrors(seed)
    target = adapters.symmetric_part(torch.randn(6, 7), p_in, p_out)
    offset = torch.randn(6)
    offset = (offset + p_out @ offset) / 2
    layer = adapters.EquivariantLinear(p_in, p_out)
    optimizer = torch.optim.Adam(layer.parameters(), 0.05)
    for _ in range(400):
        x = torch.randn(64, 7)
        loss = ((layer(x) - x @ target.T - offset) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert loss < 1e-3, f"an equivariant target, bias included, is missed by {loss:.3g} after 400 steps of Adam"
    check(layer, p_in, p_out, "after training")


def test_net_is_equivariant(seed):
    p_in, p_out = mirrors(seed)
    net = adapters.EquivariantNet(p_in, [8, 5], p_out)
    check(net, p_in, p_out, "a new network")
    shake(net)
    check(net, p_in, p_out, "a network with arbitrary parameters")
    critic = adapters.EquivariantNet(p_in, [8], torch.eye(1))
    shake(critic)
    check(critic, p_in, torch.eye(1), "a critic, whose value the mirror leaves alone")


def test_net_bends(seed):
    """A nonlinear network of the size that was asked for, whose output has an odd and an even part."""
    p_in, p_out = mirrors(seed)
    net = adapters.EquivariantNet(p_in, [8, 5], p_out)
    shake(net)
    x = torch.randn(50, 7)
    with torch.no_grad():
        curved = (net(x) + net(-x) - 2 * net(0 * x)).abs().max()
        odd, even = (net(x) - net(x) @ p_out).abs().max(), (net(x) + net(x) @ p_out).abs().max()
    assert curved > 1e-2, "the network is linear: is there an ELU between the layers?"
    assert odd > 1e-2, "the output is symmetric for every x: a robot could never turn"
    assert even > 1e-2, "the output has no symmetric part: a robot could never go straight"


def test_net_fits(seed):
    p_in, p_out = mirrors(seed)
    teacher, net = (adapters.EquivariantNet(p_in, [16], p_out) for _ in range(2))
    x = torch.randn(512, 7)
    with torch.no_grad():
        y = teacher(x)
    optimizer = torch.optim.Adam(net.parameters(), 0.01)
    first = ((net(x) - y) ** 2).mean().item()
    for _ in range(250):
        loss = ((net(x) - y) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert loss < 0.1 * first, (
        f"250 steps of Adam bring the error from {first:.3g} to {loss:.3g} only: do gradients arrive?"
    )


def test_frontier_ignores_other_levels(seed):
    rng = np.random.default_rng(seed)
    f = adapters.Frontier(10, window=5)
    f.finished(np.ones(50, int), np.ones(50))
    assert f.level == 0, "episodes on another level than the frontier say nothing"
    f.finished(np.repeat(np.arange(3), 5), np.ones(15))
    assert f.level == 3, "an episode meets the frontier of its moment: 5 good ones each on 0, 1, 2 lead to 3"
    f.finished(rng.integers(0, 3, 60), np.zeros(60))
    assert f.level == 3, "bad episodes on easier levels do not lower the frontier"


def test_frontier_counts_anew(seed):
    f = adapters.Frontier(10, window=4)
    f.finished(np.zeros(4, int), np.full(4, 0.5))
    f.finished(np.zeros(3, int), np.ones(3))
    assert f.level == 0, "after a window that decided nothing, counting starts anew: 3 episodes of 4 are not enough"
    f.finished(np.zeros(1, int), np.ones(1))
    assert f.level == 1, "4 perfect episodes in a new window raise the frontier"
    f.finished(np.ones(3, int), np.zeros(3))
    assert f.level == 1, "after the frontier moved, counting starts anew"


def test_frontier_stays_inside(seed):
    f = adapters.Frontier(3, window=2)
    for score, end in ((0.0, 0), (1.0, 2)):
        for _ in range(8):
            f.finished(np.full(2, f.level), np.full(2, score))
        assert f.level == end, f"with scores of {score} the frontier ends at level {end} of 0 ... 2, not at {f.level}"
    levels = f.draw(50, np.random.default_rng(seed))
    assert levels.min() >= 0 and levels.max() <= 2, "a level is drawn that does not exist"


def test_draw_shares(seed):
    f = adapters.Frontier(6, window=1, easier=0.4)
    levels = f.draw(100, np.random.default_rng(seed))
    assert np.shape(levels) == (100,) and not np.any(levels), "draw(n, rng) gives n levels; at level 0 all are 0"
    for _ in range(4):
        f.finished(np.array([f.level]), np.ones(1))
    levels = f.draw(8000, np.random.default_rng(seed))
    share = np.bincount(levels, minlength=6) / 8000
    assert share[4] == pytest.approx(0.6, abs=0.03), f"the frontier has a share of 1 - easier = 0.6, not {share[4]:.2f}"
    assert np.allclose(share[:4], 0.1, atol=0.02), (
        f"levels 0 ... 3 share the rest evenly, 0.1 each, not {share[:4].round(2)}"
    )
