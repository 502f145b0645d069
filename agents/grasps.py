"""The grasp benchmark: ``python -m agents.grasps --policy scripted|random|FILE`` runs the sixteen named grasps.

Every policy meets the same held-out episodes of every grasp, random actions beside it. It stands with the agents and not in
``hpac_gym``, because policies come from files that only the agents read.
"""

import json
import multiprocessing
import os
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from tqdm import tqdm

from agents.command import Parser, run, whole_number
from agents.files import replacing, writable_folder
from agents.policies import Policy, load_policy
from agents.seeds import HELD_OUT_SEED
from agents.statistics import wilson_interval
from agents.tasks import make_task
from hpac_gym.envs import GRASPS
from hpac_gym.envs.grasp_data import NOMINAL, named_grasp
from hpac_gym.sim import Camera

TASK = "hpac_gym:HPAC-Grasp-v0"
RANDOM = "random"
CHUNK = 5  # episodes that a worker does at a time
COLUMNS = 4  # of the contact sheet
VIEW = Camera(width=360, height=330, distance=0.42, yaw_deg=150.0, pitch_deg=-14.0)
VIEW_CENTRE = np.array([0.045, 0.0, 0.09])  # in the hand frame
FIRST_PANEL = 14  # of the grasps in the paper's figure


@dataclass(frozen=True, slots=True)
class Trial:
    """How one episode of a grasp ended.

    Attributes:
        phase: of the wrist when it ended.
        hold_force: mean of all contact forces in the last phase [N]; None without one.
    """

    seed: int
    success: bool
    phase: str
    hold_force: float | None


@dataclass(frozen=True, slots=True)
class Row:
    """The trials of one policy at one grasp."""

    grasp: str
    policy: str
    trials: tuple[Trial, ...]

    def summary(self) -> dict[str, Any]:
        """Success with its interval, hold force of what was held, and drops by phase."""
        wins = [trial for trial in self.trials if trial.success]
        forces = [trial.hold_force for trial in wins if trial.hold_force is not None]
        return {
            "grasp": self.grasp,
            "family": GRASPS[self.grasp].family,
            "object": GRASPS[self.grasp].object.about,
            "policy": self.policy,
            "episodes": len(self.trials),
            "successes": len(wins),
            "success_rate": len(wins) / len(self.trials),
            "interval_95": list(wilson_interval(len(wins), len(self.trials))),
            "hold_force_newton": float(np.mean(forces)) if forces else None,
            "drops_by_phase": dict(Counter(trial.phase for trial in self.trials if not trial.success).most_common()),
        }


def run_trials(policy: str, grasp: str, variant: str, seeds: Sequence[int]) -> list[Trial]:
    """Episodes of one policy at one grasp, in an environment of their own."""
    env = make_task(TASK, grasp=grasp, variant=variant)
    actor = load_policy(policy, env)
    trials = [_trial(env, actor, seed) for seed in seeds]
    env.close()
    return trials


def benchmark(
    policies: Sequence[str], grasps: Sequence[str], episodes: int,
    *, variant: str = NOMINAL, seed_start: int = HELD_OUT_SEED, workers: int = 1,
) -> list[Row]:  # fmt: skip
    """Run policies at grasps over the same held-out seeds.

    Raises:
        GraspError: No grasp or variant has that name.
        PolicyError: A policy cannot be loaded, or is of another environment.
    """
    for grasp in grasps:
        named_grasp(grasp).variant(variant)
    for policy in policies:
        run_trials(policy, grasps[0], variant, ())  # a mistake ends here, not in a worker
    seeds = range(seed_start, seed_start + episodes)
    parts = [seeds[start : start + CHUNK] for start in range(0, episodes, CHUNK)]
    cells = [(policy, grasp) for grasp in grasps for policy in policies]
    jobs = [(policy, grasp, variant, part) for policy, grasp in cells for part in parts]
    found: dict[tuple[str, str], list[Trial]] = {cell: [] for cell in cells}
    with tqdm(total=len(cells) * episodes, desc="grasps", unit="episode", disable=not sys.stderr.isatty()) as bar:
        for (policy, grasp, *_), trials in zip(jobs, _results(jobs, workers), strict=True):
            found[policy, grasp] += trials
            bar.update(len(trials))
    return [Row(grasp, policy, tuple(found[policy, grasp])) for policy, grasp in cells]


def table(rows: Sequence[Row]) -> str:
    """The rows as a table in Markdown."""
    columns = ("grasp", "object", "policy", "success", "95 % interval", "hold force", "drops by phase")
    lines = [f"| {' | '.join(columns)} |", "| --- " * len(columns) + "|"]
    for row in rows:
        numbers = row.summary()
        low, high = numbers["interval_95"]
        force = numbers["hold_force_newton"]
        drops = ", ".join(f"{phase} {count}" for phase, count in numbers["drops_by_phase"].items()) or "–"
        lines.append(
            f"| {row.grasp} | {numbers['object']} | {row.policy} | {numbers['success_rate']:.0%} | {low:.0%} … {high:.0%} "
            f"| {'–' if force is None else f'{force:.0f} N'} | {drops} |"
        )
    return "\n".join(lines)


def portrait(policy: str, grasp: str, variant: str, seeds: Sequence[int]) -> np.ndarray:
    """A picture of a grasp that was held to the end, or of the last try, shape (height, width, 3)."""
    env = make_task(TASK, grasp=grasp, variant=variant, render_mode="rgb_array")
    actor = load_policy(policy, env)
    for seed in seeds:
        if _trial(env, actor, seed).success:
            break
    scene = env.unwrapped.scene
    middle = scene.palm_position + scene.hand_rotation @ VIEW_CENTRE
    picture = VIEW.picture(scene.world, middle)
    env.close()
    return picture


def contact_sheet(pictures: dict[str, np.ndarray]) -> Image.Image:
    """All the pictures in rows, each under its number in the paper's figure and its name."""
    height, width = next(iter(pictures.values())).shape[:2]
    rows = -(-len(pictures) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width, rows * height), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(22)
    for number, (name, picture) in enumerate(pictures.items()):
        corner = (number % COLUMNS * width, number // COLUMNS * height)
        sheet.paste(Image.fromarray(picture), corner)
        panel = FIRST_PANEL + list(GRASPS).index(name)
        draw.text((corner[0] + 12, corner[1] + 8), f"{panel} {name.replace('_', ' ')}", fill=(40, 40, 40), font=font)
    return sheet


def main(argv: list[str] | None = None) -> int:
    args = _parser().parse_args(argv)
    names = args.grasps or list(GRASPS)
    policies = list(dict.fromkeys([args.policy] if args.no_baseline else [args.policy, RANDOM]))
    if args.out:
        writable_folder(args.out)
    rows = benchmark(
        policies, names, args.episodes, variant=args.variant, seed_start=args.seed_start, workers=args.workers
    )
    result = {"task": TASK, "variant": args.variant, "first_seed": args.seed_start, "grasps": [row.summary() for row in rows]}
    if args.out:
        _write(args.out, args.policy, names, args.variant, rows, result)
    print(json.dumps(result, indent=2) if args.json else table(rows))
    return 0


def _write(
    folder: Path, policy: str, names: Sequence[str], variant: str, rows: Sequence[Row], result: dict[str, Any]
) -> None:
    trials = {f"{row.grasp}/{row.policy}": [asdict(trial) for trial in row.trials] for row in rows}
    with replacing(folder / "grasps.json") as temporary:
        temporary.write_text(json.dumps({**result, "trials": trials}, indent=2) + "\n")
    seeds = range(result["first_seed"], result["first_seed"] + CHUNK)
    pictures = {}
    for name in tqdm(names, desc="pictures", disable=not sys.stderr.isatty()):
        pictures[name] = portrait(policy, name, variant, seeds)
        _save(Image.fromarray(pictures[name]), folder / f"{name}.png")
    _save(contact_sheet(pictures), folder / "contact_sheet.png")


def _save(image: Image.Image, path: Path) -> None:
    with replacing(path) as temporary:
        image.save(temporary, format="PNG")


def _trial(env: Any, policy: Policy, seed: int) -> Trial:
    observation, info = env.reset(seed=seed)
    policy.reset(seed)
    forces, done = [], False
    while not done:
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        if info["phase"] == "hold":
            forces.append(info["contact_force"])
        done = terminated or truncated
    return Trial(seed, bool(info["is_success"]), info["phase"], float(np.mean(forces)) if forces else None)


def _results(jobs: Sequence[tuple], workers: int) -> Any:
    if workers == 1:
        yield from (run_trials(*job) for job in jobs)
        return
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"))
    try:
        yield from pool.map(run_trials, *zip(*jobs, strict=True))
    finally:
        pool.shutdown(cancel_futures=True)


def _parser() -> Parser:
    parser = Parser(__doc__.splitlines()[0])
    parser.add_argument("--policy", default="scripted", help="scripted, random, or a policy file")
    parser.add_argument("--grasps", nargs="+", metavar="NAME", help="only these")
    parser.add_argument("--variant", default=NOMINAL, help="of the objects: nominal, large, small, heavy, slippery")
    parser.add_argument("--episodes", type=whole_number(1), default=50, help="of each policy at each grasp")
    parser.add_argument("--seed-start", type=whole_number(0), default=HELD_OUT_SEED, help=f"training stays below {HELD_OUT_SEED}")
    parser.add_argument("--workers", type=whole_number(1), default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--no-baseline", action="store_true", help="no random actions beside the policy")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="write the numbers, a picture of each grasp and a sheet")
    return parser


if __name__ == "__main__":
    run(main)
