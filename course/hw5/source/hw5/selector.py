"""A selector that is taught by an oracle.

**Skills are numbered in alphabetical order here**, see SKILLS.  Labels are **one-hot rows** (n, 5): a 1 in the column of
the right skill.
"""

from agility_ref import terrain
from hw5.runners import Runners

import numpy as np
import torch
from torch import nn

SKILLS = ("beam", "climb-down", "climb-up", "leap", "walk")


def label(regions: np.ndarray, cell: float, course: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return what the oracle would choose, one-hot (N, 5).

    Parameters
    ----------
    regions : (C, nx) indices into ``agility_ref.terrain.SKILLS``, which has **another order** than SKILLS
    cell : length of a cell along x [m]; cell i reaches from i cell to (i + 1) cell
    course : (N,) row of ``regions``
    x : (N,) [m]; before or behind the course the first or the last cell counts
    """
    ### BEGIN SOLUTION
    column = np.clip(np.floor(x / cell).astype(int), 0, regions.shape[1] - 1)
    order = np.array([SKILLS.index(name) for name in terrain.SKILLS])
    return np.eye(len(SKILLS))[order[regions[course, column]]]
    ### END SOLUTION


class Selector:
    """From scandots to the probability of each skill.

    Any model will do that is fitted within five seconds and names the right skill often enough.
    """

    def fit(self, scandots: np.ndarray, labels: np.ndarray, seed: int) -> "Selector":
        """Fit anew, whatever was fitted before; return self.

        Parameters
        ----------
        scandots : (n, 132) [m]
        labels : (n, 5) one-hot
        seed : of everything random; the same seed and data give the same probabilities
        """
        ### BEGIN SOLUTION
        torch.set_num_threads(1)
        generator = torch.Generator().manual_seed(seed)
        torch.manual_seed(seed)
        self.net = nn.Sequential(nn.Linear(scandots.shape[1], 64), nn.ELU(), nn.Linear(64, len(SKILLS)))
        x = torch.from_numpy(np.asarray(scandots, np.float32) / 0.3)
        y = torch.from_numpy(np.asarray(labels).argmax(axis=1))
        optimizer = torch.optim.Adam(self.net.parameters(), 3e-3)
        for _ in range(400):
            batch = torch.randint(len(x), (256,), generator=generator)
            loss = nn.functional.cross_entropy(self.net(x[batch]), y[batch])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        return self
        ### END SOLUTION

    def probabilities(self, scandots: np.ndarray) -> np.ndarray:
        """Return (n, 5), each row sums to 1."""
        ### BEGIN SOLUTION
        with torch.no_grad():
            x = torch.from_numpy(np.asarray(scandots, np.float32) / 0.3)
            return torch.softmax(self.net(x), dim=1).numpy()
        ### END SOLUTION


def choose(probabilities: np.ndarray, held: np.ndarray, margin: float) -> np.ndarray:
    """Choose skills without flickering: (n,) indices into SKILLS.

    A runner keeps the skill that it holds unless another one is more probable **by more than** ``margin``; then it
    takes the most probable one.

    Parameters
    ----------
    probabilities : (n, 5)
    held : (n,) skills of the last decision; -1 where there was none, which takes the most probable skill
    margin : 0 ... 1
    """
    ### BEGIN SOLUTION
    best = probabilities.argmax(axis=1)
    rows = np.arange(len(best))
    ahead = probabilities[rows, best] - probabilities[rows, held]
    return np.where((held < 0) | (ahead > margin), best, held)
    ### END SOLUTION


def recall(labels: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return, for every skill, the share of its states in which it was chosen, (5,); NaN for a skill without states.

    Parameters
    ----------
    labels : (n, 5) one-hot
    chosen : (n,) indices into SKILLS
    """
    ### BEGIN SOLUTION
    right = labels[np.arange(len(chosen)), chosen]
    counts = labels.sum(axis=0)
    return np.where(counts > 0, (labels * right[:, None]).sum(axis=0) / np.maximum(counts, 1), np.nan)
    ### END SOLUTION


def collect(
    runners: Runners, steps: int, selector: Selector | None, rng: np.random.Generator, oracle_share: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Run and take notes: scandots (steps N, 132) and labels (steps N, 5) of the states that were visited.

    In every state, look first, then note the **oracle's** label, then act: with probability ``oracle_share`` a runner
    does what the oracle says, else what the selector finds most probable.  ``runners.step`` wants to know who acted
    rightly.  Without a selector the oracle always acts.  What ``runners.observe`` returned may be overwritten later.
    """
    ### BEGIN SOLUTION
    seen, labels = [], []
    for _ in range(steps):
        scandots = runners.observe().copy()
        wanted = label(runners.regions, runners.cell, runners.course, runners.x)
        right = np.ones(runners.n, bool)
        if selector is not None:
            chosen = selector.probabilities(scandots).argmax(axis=1)
            right = wanted[np.arange(runners.n), chosen] > 0
            right |= rng.random(runners.n) < oracle_share
        seen.append(scandots)
        labels.append(wanted)
        runners.step(right)
    return np.concatenate(seen), np.concatenate(labels)
    ### END SOLUTION


def dagger(runners: Runners, rounds: int, steps: int, seed: int) -> Selector:
    """Learn where the learner goes: (Ross, Gordon and Bagnell 2011).

    The oracle acts for ``steps`` steps and a selector is fitted.  Then, ``rounds`` times, the latest selector acts for
    ``steps`` steps and is fitted anew to **everything** collected so far.
    """
    ### BEGIN SOLUTION
    rng = np.random.default_rng(seed)
    data = [collect(runners, steps, None, rng)]
    selector = Selector().fit(*data[0], seed)
    for _ in range(rounds):
        data.append(collect(runners, steps, selector, rng))
        scandots, labels = (np.concatenate(part) for part in zip(*data, strict=True))
        selector = Selector().fit(scandots, labels, seed)
    return selector
    ### END SOLUTION
