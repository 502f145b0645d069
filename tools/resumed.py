"""Whether killed and resumed trainings end as uninterrupted ones do: ``python -m tools.resumed
--out runs/resumed``.

Trains the recipe *grasp* twice per seed: whole, and killed without warning seconds after it has
saved a third and two thirds of its trials, then resumed. Both must give the same policy to the last
bit. A repeated call skips finished trainings."""

import subprocess
import sys
import time
from pathlib import Path

from agents import POLICY, RunError
from agents.runs import saved_trials
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.policies import read_policy

SETTINGS = {"random-episodes": 500, "updates-per-episode": 0.3, "checkpoint-every": 500}
"""Settings with which a short training learns, and saves often enough to be killed twice."""
LATER_S = 5.0
"""Time from a checkpoint to the kill [s]; the trials in between are lost."""


def train(out: Path, seed: int, trials: int, kills: int) -> str:
    """Train in a folder, killed after equal shares of the trials; returns the hash of the policy's
    weights.

    Raises:
        RunError: A training failed.
    """
    settings = [word for name, value in SETTINGS.items() for word in (f"--{name}", value)]
    fresh = ["grasp", "--seed", seed, "--episodes", trials, *settings, "--overwrite"]
    for part in range(kills + 1) if saved_trials(out) < trials else ():
        words = [*(["--resume"] if part else fresh), "--out", out]
        process = subprocess.Popen(
            [sys.executable, "-m", "agents.train", *map(str, words)], stderr=subprocess.DEVNULL
        )
        while (
            part < kills
            and saved_trials(out) * (kills + 1) < trials * (part + 1)
            and process.poll() is None
        ):
            time.sleep(0.1)
        if part < kills and process.poll() is None:
            time.sleep(LATER_S)
            process.kill()
        if process.wait() != (-9 if part < kills else 0):
            raise RunError(
                f"the training in '{out}' ended with status {process.returncode} after {saved_trials(out):,} trials"
            )
    return read_policy(out / POLICY).about["sha256"]


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("tools.resumed", __doc__)
    parser.add_argument(
        "--seeds", type=whole_number(1), default=5, help="number of pairs of trainings"
    )
    parser.add_argument(
        "--trials", type=whole_number(1_500), default=3_000, help="trials per training"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the trainings")
    args = parser.parse_args(argv)
    equal = 0
    for seed in range(args.seeds):
        whole, resumed = (
            train(args.out / f"{name}-{seed}", seed, args.trials, n)
            for name, n in (("whole", 0), ("resumed", 2))
        )
        equal += whole == resumed
        print(
            f"seed {seed}: {'the same policy' if whole == resumed else 'another policy'}",
            flush=True,
        )
    return 0 if equal == args.seeds else 1


if __name__ == "__main__":
    sys.exit(run(main))
