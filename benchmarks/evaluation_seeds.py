"""Two evaluations of the same weights on other courses: how often their intervals are right.

    agility-ref table1 --results one
    agility-ref table1 --seed 2 --results two
    python benchmarks/evaluation_seeds.py one/table1.csv two/table1.csv [--json]

For every number of Table 1 that has an interval in both: whether the difference of the two interquartile
means lies within its own interval, whether the printed intervals overlap, and whether the second mean lies within
the first's interval.  The difference of two independent estimates varies more than either:

    half width of the difference = sqrt(a^2 + b^2)        a, b: half widths towards each other

So the first share should be 0.95, while of the third only P(|Z| < 1.96 / sqrt 2) = 0.83 can be asked.
"""

from dataclasses import asdict, dataclass
from typing import Annotated

from agility_ref.errors import UserError
from agility_ref.evaluate import METRICS
from agility_ref.files import read_csv

import numpy as np
from common import machine, report, start
from tyro.conf import Positional


@dataclass(frozen=True)
class Config:
    """Two evaluations compared."""

    one: Annotated[str, Positional]
    """table1.csv of the first evaluation."""
    two: Annotated[str, Positional]
    """table1.csv of the second."""
    json: bool = False
    """Print one JSON object."""


def read_cells(path: str) -> dict[tuple[str, str], dict[str, str]]:
    """Read a table: (environment, policy) -> its row.

    Raises
    ------
    UserError : there is no such file, or it has no intervals
    """
    rows = read_csv(path)
    if not rows or "reward_low" not in rows[0]:
        raise UserError(f"{path} is not a table1.csv with intervals")
    return {(row["environment"], row["policy"]): row for row in rows}


def agreement(one: np.ndarray, two: np.ndarray) -> dict[str, np.ndarray]:
    """Compare (estimate, low, high) of two evaluations, shape (n, 3) each; return (n,) bool each."""
    swap = one[:, 0] > two[:, 0]
    lower, upper = np.where(swap[:, None], two, one), np.where(swap[:, None], one, two)
    towards = np.hypot(lower[:, 2] - lower[:, 0], upper[:, 0] - upper[:, 1])
    return {
        "difference within its interval": upper[:, 0] - lower[:, 0] <= towards,
        "intervals overlap": lower[:, 2] >= upper[:, 1],
        "second within the first's": (one[:, 1] <= two[:, 0]) & (two[:, 0] <= one[:, 2]),
    }


def main(config: Config) -> None:
    started = machine()
    first, second = read_cells(config.one), read_cells(config.two)
    shares, tables = {}, []
    for metric in METRICS:
        columns = [f"{metric}_{part}" for part in ("iqm", "low", "high")]
        pairs = [(first[cell], second[cell]) for cell in first if cell in second]
        pairs = [pair for pair in pairs if all(row[c] for row in pair for c in columns)]
        if not pairs:
            raise UserError("the two tables share no cells")
        one, two = (np.array([[float(pair[k][c]) for c in columns] for pair in pairs]) for k in (0, 1))
        found = agreement(one, two)
        shares[metric] = {name: float(values.mean()) for name, values in found.items()} | {"cells": len(pairs)}
        tables.append({"metric": metric} | {n: f"{v.mean():.2f}" for n, v in found.items()} | {"cells": len(pairs)})
    report(config.json, started, {"config": asdict(config), "agreement": shares}, tables)


if __name__ == "__main__":
    start(main, Config)
