"""A robot that walks.  Budget and threshold: training.csv; how they were found: ``python -m course threshold hw3``."""

import csv
from pathlib import Path

import pytest
from hw3.train import distance, train

with (Path(__file__).parent / "training.csv").open(newline="") as file:
    TABLE = {row["name"]: float(row["value"]) for row in csv.DictReader(file)}


@pytest.mark.training
@pytest.mark.seconds(int(TABLE["seconds"]))
def test_training_walks():
    got = distance(*train(int(TABLE["steps"]), seed=0))
    assert got >= TABLE["metres"], (
        f"after {TABLE['steps']:.0f} steps the robot gets {got:.2f} m far in 8 s, asked are {TABLE['waypoints']:.2f}"
    )
