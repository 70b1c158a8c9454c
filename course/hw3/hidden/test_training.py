"""A robot that walks.  Budget and threshold: training.csv; how they were found: ``python -m course threshold hw3``."""

import csv
from pathlib import Path

import pytest
from hw3.train import train, waypoints

with (Path(__file__).parent / "training.csv").open(newline="") as file:
    TABLE = {row["name"]: float(row["value"]) for row in csv.DictReader(file)}


@pytest.mark.training
@pytest.mark.seconds(int(TABLE["seconds"]))
def test_training_walks():
    got = waypoints(*train(int(TABLE["steps"]), seed=0))
    assert got >= TABLE["waypoints"], (
        f"after {TABLE['steps']:.0f} steps the robot reaches {got:.2f} waypoints in 8 s, asked are {TABLE['waypoints']:.2f}"
    )
