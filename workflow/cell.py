"""One cell of Table 1 as a step of the workflow: play it and store it where ``agility-ref table1`` finds it."""

import argparse
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig
from agility_ref.results.cells import enter, find_cell
from agility_ref.training.bank import WeightsConfig

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("policy")
    parser.add_argument("environment")
    parser.add_argument("--preset", required=True, help="of the weights and the courses")
    parser.add_argument("--seed", type=int, required=True, help="training seed of the weights")
    parser.add_argument("--episodes", type=int, required=True, help="on the courses of evaluation seed 1")
    parser.add_argument("--runs", required=True, help="folder of runs")
    parser.add_argument("--results", type=Path, required=True, help="folder of the table")
    args = parser.parse_args()
    try:
        entrant = enter(args.policy, WeightsConfig(preset=args.preset, seed=args.seed, out=args.runs))
        config = EvaluationConfig(episodes=args.episodes, seed=1, preset=args.preset)
        find_cell(entrant, args.environment, config, args.results / "cells")
    except UserError as error:
        parser.error(str(error))
