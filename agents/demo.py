"""From random weights to the wire: train a grasp, evaluate and film it, deploy it through a serial
port on the firmware, and compare that with a simulation.

``make demo`` runs it; each step is a separate command, which is printed.
"""

import subprocess
import sys
import time
from pathlib import Path

from hpac_gym.command import add_counts, command_parser, minutes, run
from hpac_gym.output import writable_folder

RESULTS = (
    "learning_curve.png",
    "results.md",
    "results.json",
    "deploy.jsonl",
    "deploy.wire.jsonl",
    "replay.png",
    "grasps.mp4",
)
STEPS = (
    (
        "Train from random weights",
        "agents.train grasp --out {out} --seed {seed} --overwrite --time-limit {minutes:g}",
    ),
    (
        "Judge it and the baselines",  # five minutes are enough; a slower machine judges fewer
        "hpac evaluate --policy {out}/policy.hpac --episodes {episodes} --workers 2 --time-limit 5"
        " --out {out}/results.json",
    ),
    ("Draw the learning curve", "agents.curves {out}"),
    ("Film it", "hpac show --policy {out}/policy.hpac --episodes 4 --record {out}/grasps.mp4"),
    (
        "Deploy it, through a serial port, on the firmware",  # before the open hand stands a can
        "hpac deploy {out}/policy.hpac --port host --object cylinder:0.027,0.05"
        " --pose 0.048,0.004,0.112 --log {out}/deploy.jsonl",
    ),
    ("Compare the deployment", "hpac replay {out}/deploy.jsonl --out {out}/replay.png"),
)
"""Title, and module with arguments, of every step."""


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("agents.demo", __doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/demo"), help="folder of the results")
    parser.add_argument("--minutes", type=minutes, default=10.0, help="training time")
    add_counts(
        parser,
        episodes=(1, 400, "held-out episodes of each policy"),
        seed=(0, 0, "seed of the training"),
    )
    args = parser.parse_args(argv)
    writable_folder(args.out)
    started = time.monotonic()
    for number, (title, command) in enumerate(STEPS):
        words = [word.format(**vars(args)) for word in command.split()]
        print(f"\n== {title}\n   python -m {' '.join(words)}", flush=True)
        status = subprocess.run([sys.executable, "-m", *words], check=False).returncode
        if status:
            return status  # the command has printed the reason
        if number == 0:
            for name in RESULTS[1:]:  # those of an earlier demo are not about the new policy
                (args.out / name).unlink(missing_ok=True)
    print(f"\nDone in {(time.monotonic() - started) / 60:.1f} minutes. In {args.out}:")
    for name in RESULTS:
        print(f"   {name}{'' if (args.out / name).exists() else ' is missing'}")
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
