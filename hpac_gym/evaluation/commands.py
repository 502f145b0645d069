"""The evaluation's command of `hpac`: grasps."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from hpac import whole_number
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.workers import shared
from hpac_gym.output import writable_folder, write_text
from hpac_gym.policies import read_policy
from hpac_gym.progress import progress

if TYPE_CHECKING:
    from hpac_gym.evaluation.grasps import Trial

RANDOM = "random"
_ABOUT = """\
Runs a policy, and random actions beside it, at the sixteen named grasps over the same held-out episodes. Prints a table:
success with its Wilson 95 % interval, hold force, drops by phase. Writes it with a picture of each grasp and a contact
sheet. A grasp is shown as the first episode left it that was a success, or the last one of all."""


def add_grasps(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac grasps`."""
    parser.description = _ABOUT
    parser.add_argument("--policy", default="scripted", help="scripted, random, or a policy file (default: %(default)s)")
    parser.add_argument("-n", "--episodes", type=whole_number(1), default=50, metavar="N",
                        help="of each policy at each grasp (default: %(default)s; 5 for a first look)")  # fmt: skip
    parser.add_argument("--grasps", nargs="+", metavar="NAME", help="only these (default: all sixteen)")
    parser.add_argument("--variant", help="of the objects: large, small, heavy, slippery or shape (default: nominal)")
    parser.add_argument("--seed-start", type=whole_number(0), default=HELD_OUT_SEED, metavar="SEED",
                        help=f"of the first episode (default: %(default)s; training stays below {HELD_OUT_SEED})")  # fmt: skip
    parser.add_argument("--no-baseline", action="store_true", help="no random actions beside the policy")
    parser.add_argument("--workers", type=whole_number(1), default=os.cpu_count() or 1, metavar="N",
                        help="processes (default: %(default)s)")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("runs/grasps"), metavar="DIR",
                        help="where table and pictures go (default: %(default)s)")  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    parser.set_defaults(run=_grasps)


def _grasps(options: argparse.Namespace) -> int:
    # Here and not above: the help of this command needs no engine and no Pillow.
    from hpac_gym.envs import GRASPS, NOMINAL
    from hpac_gym.evaluation.grasps import TASK, benchmark, table
    from hpac_gym.evaluation.pictures import portrait, write_pictures
    from hpac_gym.policies.baselines import BASELINES

    variant, names = options.variant or NOMINAL, list(dict.fromkeys(options.grasps or GRASPS))
    policies = list(dict.fromkeys([options.policy] if options.no_baseline else [options.policy, RANDOM]))
    writable_folder(options.out)
    rows = benchmark(
        policies, names, options.episodes, variant=variant, seed_start=options.seed_start, workers=options.workers
    )  # fmt: skip
    result = {"task": TASK, "variant": variant, "first_seed": options.seed_start, "grasps": [row.summary() for row in rows]}
    if options.policy not in BASELINES:
        result["policy"] = {"file": options.policy, **read_policy(options.policy).about}
    trials = {f"{row.grasp}/{row.policy}": [asdict(trial) for trial in row.trials] for row in rows}
    write_text(options.out / "grasps.json", json.dumps({**result, "trials": trials}, indent=2) + "\n")
    write_text(options.out / "grasps.md", table(rows) + "\n")

    shown = [row for row in rows if row.policy == options.policy]
    jobs = [(options.policy, row.grasp, _shown_seed(row.trials), variant) for row in shown]
    seen = zip(progress(shown, "pictures", sys.stderr.isatty()), shared(portrait, jobs, options.workers), strict=True)
    write_pictures(options.out, {row.grasp: picture for row, picture in seen})
    print(json.dumps(result, indent=2) if options.json else table(rows))
    print(f"written to {options.out}", file=sys.stderr)
    return 0


def _shown_seed(trials: Sequence[Trial]) -> int:
    """The first success, or the last failure."""
    return next((trial.seed for trial in trials if trial.success), trials[-1].seed)
