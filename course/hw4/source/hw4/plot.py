"""A learner that forgets, taught by your frontier.  Run ``python -m hw4.plot``; it writes frontier.png.

The learner has a skill for every level.  It learns a level by playing it if it is good at the one below, and
forgets, slowly, what it does not play.  This is a caricature of a robot, but it runs in a second.
"""

import hw4.frontier  # before numpy: it imports agility_ref

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

LEVELS, ROBOTS, ROUNDS = 10, 64, 400


def learn(easier: float, window: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Teach a learner; return frontier (ROUNDS,) and mean skill over all levels (ROUNDS,)."""
    rng = np.random.default_rng(seed)
    frontier = hw4.frontier.Frontier(LEVELS, window, easier=easier)
    skill = np.zeros(LEVELS)
    levels, skills = [], []
    for _ in range(ROUNDS):
        played = frontier.draw(ROBOTS, rng)
        scores = np.clip(skill[played] + 0.2 * rng.standard_normal(ROBOTS), 0.0, 1.0)
        frontier.finished(played, scores)
        count = np.bincount(played, minlength=LEVELS)
        ready = np.concatenate([[1.0], skill[:-1]])
        skill += 0.002 * count * ready * (1.0 - skill) - 0.004 * skill
        levels.append(frontier.level)
        skills.append(skill.mean())
    return np.array(levels), np.array(skills)


def main() -> None:
    """Draw three shares of easier episodes."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    for easier in (0.0, 0.3, 0.9):
        levels, skills = np.mean([learn(easier, 20, seed) for seed in range(5)], axis=0)
        left.plot(levels, label=f"easier = {easier}")
        right.plot(skills, label=f"easier = {easier}")
    left.set(xlabel="round", ylabel="frontier")
    right.set(xlabel="round", ylabel="mean skill over all levels")
    right.legend()
    figure.savefig("frontier.png", dpi=150)
    print("frontier.png")


if __name__ == "__main__":
    main()
