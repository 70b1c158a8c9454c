"""Table 1 as a step of the workflow: from stored cells, as ``agility-ref table1`` writes it."""

import argparse
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig
from agility_ref.results import table1
from agility_ref.results.cells import Cell, cell_path, enter, origin, read_cell
from agility_ref.training.bank import WeightsConfig


def stored(policy: str, environment: str, training: WeightsConfig, config: EvaluationConfig, folder: Path) -> Cell:
    """Read a cell, which a rule of its own has made; nothing is played here.

    Raises
    ------
    UserError : it was not made from these weights and files
    """
    entrant = enter(policy, training)
    path = cell_path(folder, entrant.policy, environment, training.seed)
    cell = read_cell(path, origin(entrant, environment, config))
    if cell is None:
        raise UserError(f"{path} was not made from these weights and files")
    return cell


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cells", nargs="+", help="POLICY:ENVIRONMENT")
    parser.add_argument("--preset", required=True)
    parser.add_argument("--seeds", type=int, nargs="+", required=True, help="training seeds")
    parser.add_argument("--episodes", type=int, required=True)
    parser.add_argument("--runs", required=True, help="folder of runs")
    parser.add_argument("--results", type=Path, required=True, help="folder of the table")
    args = parser.parse_args()
    cells = {}
    try:
        config = EvaluationConfig(episodes=args.episodes, seed=1, preset=args.preset)
        for seed in args.seeds:
            training = WeightsConfig(preset=args.preset, seed=seed, out=args.runs)
            for policy, environment in (cell.split(":") for cell in args.cells):
                cells[policy, environment, seed] = stored(policy, environment, training, config, args.results / "cells")
    except UserError as error:
        parser.error(str(error))
    rows = table1.table_rows(cells)
    table1.write_all(rows, args.results, table1.title(config, rows))
