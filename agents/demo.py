"""From random weights to the wire: train a grasp, evaluate and film it, deploy it through a serial
port on the firmware, and compare that with a simulation.

``make demo`` runs it; each step is a separate command, which is printed.
"""

import subprocess
import sys
import time
from pathlib import Path

from hpac_gym.command import command_parser, minutes, run, whole_number
from hpac_gym.output import writable_folder

EVALUATION_MINUTES = (
    5.0  # enough for 400 episodes of three policies; a slower machine evaluates fewer
)
RESULTS = (
    "learning_curve.png",
    "results.md",
    "results.json",
    "deploy.jsonl",
    "deploy.wire.jsonl",
    "replay.png",
    "grasps.mp4",
)
OBJECT = ("--object", "cylinder:0.027,0.05", "--pose", "0.048,0.004,0.112")
"""What the camera would see on the deployment: a can in front of the open hand."""


def steps(
    out: Path, training_minutes: float, episodes: int, seed: int
) -> list[tuple[str, list[str]]]:
    """Title, and module with arguments, of every step."""
    policy = str(out / "policy.hpac")
    log = str(out / "deploy.jsonl")
    train = ["agents.train", "grasp", "--out", str(out), "--seed", str(seed), "--overwrite"]
    judge = ["hpac", "evaluate", "--policy", policy, "--episodes", f"{episodes}", "--workers", "2"]
    results = ["--time-limit", f"{EVALUATION_MINUTES:g}", "--out", str(out / "results.json")]
    film = ["--episodes", "4", "--record", str(out / "grasps.mp4")]
    return [
        ("Train from random weights", [*train, "--time-limit", f"{training_minutes:g}"]),
        ("Judge it and the baselines", [*judge, *results]),
        ("Draw the learning curve", ["agents.curves", str(out)]),
        ("Film it", ["hpac", "show", "--policy", policy, *film]),
        (
            "Deploy it, through a serial port, on the firmware",
            ["hpac", "deploy", policy, "--port", "host", *OBJECT, "--log", log],
        ),
        ("Compare the deployment", ["hpac", "replay", log, "--out", str(out / "replay.png")]),
    ]


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("agents.demo", __doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/demo"), help="folder of the results")
    parser.add_argument("--minutes", type=minutes, default=10.0, help="training time")
    parser.add_argument(
        "--episodes", type=whole_number(1), default=400, help="held-out episodes of each policy"
    )
    parser.add_argument("--seed", type=whole_number(0), default=0, help="seed of the training")
    args = parser.parse_args(argv)
    writable_folder(args.out)
    started = time.monotonic()
    for number, (title, words) in enumerate(
        steps(args.out, args.minutes, args.episodes, args.seed)
    ):
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
