"""Which level to practise: one frontier, shared by all robots."""

import numpy as np


class Frontier:
    """The level that is being learned; all below it are known.

    Attributes
    ----------
    level : int, 0 at the start
    """

    def __init__(self, levels: int, window: int = 20, up: float = 0.75, down: float = 0.25, easier: float = 0.3):
        """Start at level 0.

        Parameters
        ----------
        levels : how many there are: 0 ... levels - 1
        window : episodes on the frontier after which it is decided
        up, down : see :meth:`finished`
        easier : share of episodes on a level below the frontier, against forgetting
        """
        self.levels, self.window, self.up, self.down, self.easier = levels, window, up, down, easier
        self.level = 0
        ### BEGIN SOLUTION
        self.scores: list[float] = []
        ### END SOLUTION

    def finished(self, played: np.ndarray, scores: np.ndarray) -> None:
        """Take note of episodes, in the order in which they ended.

        Only episodes on the frontier count; one that was played on another level says nothing.  As soon as
        ``window`` of them have been counted their mean score decides: at or above ``up`` the frontier goes one
        level up, below ``down`` one level down, never beyond the first or the last.  Then counting starts anew,
        **whatever was decided**.  The next episode of the same call already meets the new frontier.

        Parameters
        ----------
        played : (n,) level of each episode
        scores : (n,) in 0 ... 1
        """
        ### BEGIN SOLUTION
        for level, score in zip(played, scores, strict=True):
            if level != self.level:
                continue
            self.scores.append(score)
            if len(self.scores) == self.window:
                mean = np.mean(self.scores)
                step = int(mean >= self.up) - int(mean < self.down)
                self.level = int(np.clip(self.level + step, 0, self.levels - 1))
                self.scores = []
        ### END SOLUTION

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw levels for n new episodes, (n,) int.

        With probability ``easier`` a level below the frontier, each as likely as the others; else the frontier.
        """
        ### BEGIN SOLUTION
        levels = np.full(n, self.level)
        if self.level:
            below = rng.random(n) < self.easier
            levels[below] = rng.integers(0, self.level, below.sum())
        return levels
        ### END SOLUTION
