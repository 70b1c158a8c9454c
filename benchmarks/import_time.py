"""How long the package and its command take to start, and how much memory training needs.

python benchmarks/import_time.py [--json]
"""

import resource
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass

from common import alternate, machine, peak_memory, report, start

COMMANDS = {
    "python -c pass": ["-c", "pass"],
    "import agility_ref": ["-c", "import agility_ref"],
    "import agility_ref.env": ["-c", "import agility_ref.env"],
    "agility-ref --help": ["-m", "agility_ref", "--help"],
    "agility-ref train --help": ["-m", "agility_ref", "train", "--help"],
}


@dataclass(frozen=True)
class Config:
    """Start-up time and memory."""

    rounds: int = 5
    """Fresh processes of each command; the median counts."""
    train_steps: int = 40_000
    """Environment steps of the training whose peak memory is measured."""
    json: bool = False
    """Print one JSON object."""


def run(arguments: list[str]) -> None:
    """Run Python in a fresh process, quietly."""
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)


def main(config: Config) -> None:
    started = machine()
    seconds = alternate({name: lambda a=a: run(a) for name, a in COMMANDS.items()}, config.rounds)
    with tempfile.TemporaryDirectory() as folder:
        budget = ["--steps", str(config.train_steps), "--out", folder]
        run(["-m", "agility_ref", "train", "walk", "--preset", "quick", *budget])
    figures = {
        "seconds": {name: float(sorted(values)[len(values) // 2]) for name, values in seconds.items()},
        "train_peak_memory_gb": peak_memory(resource.RUSAGE_CHILDREN),  # training is the largest of them
    }
    rows = [{"command": name, "seconds": f"{value:.2f}"} for name, value in figures["seconds"].items()]
    memory = [{"command": "agility-ref train walk", "peak memory [GB]": f"{figures['train_peak_memory_gb']:.2f}"}]
    report(config.json, started, {"config": asdict(config), **figures}, rows, memory)


if __name__ == "__main__":
    start(main, Config)
