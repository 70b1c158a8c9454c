"""A robot that walks.  Budget and threshold: training.csv; what to set them to: ``python -m course threshold hw3``."""

import csv
from pathlib import Path

import adapters  # noqa: F401  (before numpy)
import pytest
from hw3.train import train

with (Path(__file__).parent / "training.csv").open(newline="") as file:
    TABLE = {row["name"]: float(row["value"]) for row in csv.DictReader(file)}


@pytest.mark.training
@pytest.mark.seconds(int(TABLE["seconds"]))
def test_training_walks():
    _, _, speed = train(int(TABLE["steps"]), seed=0)
    assert speed >= TABLE["speed"], (
        f"after {TABLE['steps']:.0f} steps the robots go ahead with {speed:.3f} m/s; at least {TABLE['speed']:g} m/s is needed"
    )
