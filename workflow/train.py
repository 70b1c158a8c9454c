"""One training as a step of the workflow: ``agility-ref train``, and a marker that names the weights.

A run that was stopped goes on from its folder, unless a policy that it starts from or chooses among has been
trained anew since: then it starts anew as well.  Flags that are not listed here are handed on.
"""

import argparse
import shutil
import sys
from pathlib import Path

from agility_ref.cli.main import main
from agility_ref.policy import Policy
from agility_ref.training.bank import run_folder
from agility_ref.training.policies import requirements


def train(policy: str, seed: int, out: Path, flags: list[str]) -> int:
    """Train one policy with the command line's flags; return the exit status."""
    run = run_folder(out, policy, seed)
    needs = "".join((run_folder(out, name, seed) / "DIGEST").read_text() for name in requirements(policy))
    recorded = run / "needs.txt"
    if recorded.exists() and recorded.read_text() != needs:
        shutil.rmtree(run)
    run.mkdir(parents=True, exist_ok=True)
    recorded.write_text(needs)
    (run / "DONE").unlink(missing_ok=True)  # a finished run goes on where the budget has grown
    status = main(["train", policy, "--seed", str(seed), "--out", str(out), *flags])
    if status == 0:
        (run / "DIGEST").write_text(f"{policy} {Policy.load(run / 'policy.npz').digest()}\n")
    return status


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("policy")
    parser.add_argument("--seed", type=int, default=0, help="training seed")
    parser.add_argument("--out", type=Path, required=True, help="folder of runs")
    args, flags = parser.parse_known_args()
    sys.exit(train(args.policy, args.seed, args.out, flags))
