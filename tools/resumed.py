"""Whether killed and resumed trainings end as uninterrupted ones do: ``python -m tools.resumed --out runs/resumed``.

Trains the recipe *grasp* twice per seed: whole, and killed without warning seconds after it has saved a third and two thirds of
its trials, then resumed. Evaluates all policies on the same held-out episodes. A repeated call skips finished trainings.
"""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from agents import POLICY, RunError, command_parser, reproduce
from agents.train import saved_trials
from hpac import run, whole_number
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import stratified_bootstrap

SETTINGS = {"random-episodes": 500, "updates-per-episode": 0.3, "checkpoint-every": 500}
"""Settings with which a short training learns, and saves often enough to be killed twice."""
LATER_S = 5.0
"""Time from a checkpoint to the kill [s]; the trials in between are lost."""


def train(out: Path, seed: int, trials: int, kills: int) -> None:
    """Train in a folder; each kill comes after an equal share of the trials.

    Raises:
        RunError: A training failed.
    """
    settings = [word for name, value in SETTINGS.items() for word in (f"--{name}", value)]
    fresh = ["grasp", "--seed", seed, "--episodes", trials, *settings, "--overwrite"]
    for part in range(kills + 1):
        words = [*(["--resume"] if part else fresh), "--out", out]
        process = subprocess.Popen([sys.executable, "-m", "agents.train", *map(str, words)], stderr=subprocess.DEVNULL)
        while part < kills and saved_trials(out) * (kills + 1) < trials * (part + 1) and process.poll() is None:
            time.sleep(0.1)
        if part < kills and process.poll() is None:
            time.sleep(LATER_S)
            process.kill()
        if process.wait() != (-9 if part < kills else 0):
            raise RunError(f"the training in '{out}' ended with status {process.returncode} after {saved_trials(out):,} trials")


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("tools.resumed", __doc__)
    parser.add_argument("--seeds", type=whole_number(2), default=5, help="number of pairs of trainings")
    parser.add_argument("--trials", type=whole_number(1_500), default=3_000, help="trials per training")
    parser.add_argument("--episodes", type=whole_number(1), default=400, help="held-out episodes per policy")
    parser.add_argument("--out", type=Path, required=True, help="folder of the trainings")
    args = parser.parse_args(argv)
    cells: dict[str, list] = {"whole": [], "resumed": []}
    print(f"| {' | '.join(reproduce.RACED)} |\n{'| --- ' * len(reproduce.RACED)}|")
    for seed in range(args.seeds):
        for name, done in cells.items():
            out = args.out / f"{name}-{seed}"
            if saved_trials(out) < args.trials:
                train(out, seed, args.trials, kills=2 if name == "resumed" else 0)
            done.append(reproduce.judged_run(name, seed, str(out / POLICY), args.episodes, HELD_OUT_SEED, 1))
            print(reproduce.race_row(done[-1]), flush=True)
    for name, done in cells.items():
        print(f"\n{name}: {reproduce.over_runs(done)}")
    rates = {name: np.array([[cell["success_rate"]] for cell in done]) for name, done in cells.items()}
    gaps = 100 * (rates["resumed"] - rates["whole"])
    low, high = stratified_bootstrap(lambda drawn: drawn.mean(axis=(-2, -1)), gaps)
    print(f"\nresumed less whole, mean over seeds: {gaps.mean():+.1f} points [{low:+.1f}, {high:+.1f}]")
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
