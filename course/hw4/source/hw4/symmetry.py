"""Networks that cannot tell left from right.

A mirror is a square **matrix** P: the mirror image of a column x is P x.  Looking into the mirror twice changes
nothing, P P = 1; our mirrors swap entries and flip signs, so P is also its own transpose.  A map f is equivariant if

    f(P_in x) = P_out f(x)        for every x:

who sees the mirrored world does the mirrored thing.
"""

import itertools

import torch
from torch import nn

JOINTS = [f"{leg}_{part}" for part in ("hip", "thigh", "calf") for leg in ("FL", "FR", "RL", "RR")]
"""Joints in the order of this assignment: four hips, four thighs, four calves."""


def pair_swap(pairs: int) -> torch.Tensor:
    """Return the mirror (2 pairs, 2 pairs) that swaps entry k with entry k + pairs."""
    return torch.eye(2 * pairs).roll(pairs, 0)


def joint_mirror() -> torch.Tensor:
    """Return the mirror (12, 12) of joint angles in the order of JOINTS.

    Hips turn about the x axis, which points ahead; thighs and calves about the y axis, which points to the left.
    """
    ### BEGIN SOLUTION
    mirror = torch.zeros(12, 12)
    for k, joint in enumerate(JOINTS):
        other = joint[0] + {"L": "R", "R": "L"}[joint[1]] + joint[2:]
        # a turn about x changes its sense in a mirror that swaps left and right, a turn about y does not
        mirror[JOINTS.index(other), k] = -1.0 if joint.endswith("hip") else 1.0
    return mirror
    ### END SOLUTION


def symmetric_part(weight: torch.Tensor, p_in: torch.Tensor, p_out: torch.Tensor) -> torch.Tensor:
    """Return the equivariant matrix that is nearest to ``weight``, (out, in)."""
    ### BEGIN SOLUTION
    # P_out W = W P_in for W -> (W + P_out W P_in) / 2
    return (weight + p_out @ weight @ p_in) / 2
    ### END SOLUTION


class EquivariantLinear(nn.Module):
    """A linear layer with bias, equivariant whatever its parameters are: after a step of any optimiser too.

    Every equivariant linear layer can be reached by training, and a new layer neither is zero nor blows up: inputs
    of variance 1 give outputs of a variance between 0.1 and 3.
    """

    def __init__(self, p_in: torch.Tensor, p_out: torch.Tensor):
        super().__init__()
        self.register_buffer("p_in", p_in)
        self.register_buffer("p_out", p_out)
        ### BEGIN SOLUTION
        # the symmetric part has half of the variance of the matrix that it is made of
        self.weight = nn.Parameter(torch.randn(len(p_out), len(p_in)) * (2 / len(p_in)) ** 0.5)
        self.bias = nn.Parameter(torch.zeros(len(p_out)))
        ### END SOLUTION

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map a batch of rows, (n, in) -> (n, out)."""
        ### BEGIN SOLUTION
        weight = symmetric_part(self.weight, self.p_in, self.p_out)
        bias = (self.bias + self.p_out @ self.bias) / 2
        return x @ weight.T + bias
        ### END SOLUTION


class EquivariantNet(nn.Module):
    """Equivariant layers with a nonlinearity between them.

    Hidden units come in pairs that swap under the mirror: a layer of ``pairs`` pairs has the mirror
    ``pair_swap(pairs)``.  Use ELU.  (Why pairs?  What would ELU do to a unit that changes its sign?)
    """

    def __init__(self, p_in: torch.Tensor, pairs: list[int], p_out: torch.Tensor):
        super().__init__()
        ### BEGIN SOLUTION
        mirrors = [p_in, *map(pair_swap, pairs), p_out]
        self.layers = nn.ModuleList(EquivariantLinear(a, b) for a, b in itertools.pairwise(mirrors))
        ### END SOLUTION

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map a batch of rows, (n, in) -> (n, out)."""
        ### BEGIN SOLUTION
        for layer in self.layers[:-1]:
            x = nn.functional.elu(layer(x))
        return self.layers[-1](x)
        ### END SOLUTION
