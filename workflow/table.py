"""Table 1 as a step of the workflow: from stored cells, as ``agility-ref table1`` writes it."""

import argparse
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig
from agility_ref.results import table1
from agility_ref.results.cells import enter, find_cell
from agility_ref.training.bank import WeightsConfig


def refuse(policy: str, environment: str, seed: int) -> None:
    """Refuse to play a cell here: it belongs to a rule of its own.

    Raises
    ------
    UserError : always
    """
    raise UserError(f"the cell of {policy} on {environment}, seed {seed}, was not made from these weights and files")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cells", nargs="+", help="POLICY:ENVIRONMENT")
    parser.add_argument("--preset", required=True)
    parser.add_argument("--seeds", type=int, nargs="+", required=True, help="training seeds")
    parser.add_argument("--episodes", type=int, required=True)
    parser.add_argument("--runs", required=True, help="folder of runs")
    parser.add_argument("--results", type=Path, required=True, help="folder of the table")
    args = parser.parse_args()
    config = EvaluationConfig(episodes=args.episodes, seed=1, preset=args.preset)
    cells = {}
    for seed in args.seeds:
        training = WeightsConfig(preset=args.preset, seed=seed, out=args.runs)
        for policy, environment in (cell.split(":") for cell in args.cells):
            found = find_cell(enter(policy, training), environment, config, args.results / "cells", refuse)
            cells[policy, environment, seed] = found
    rows = table1.table_rows(cells)
    table1.write_all(rows, args.results, table1.title(config, rows))
