"""Evaluate the sixteen grasp types: ``python -m tools.grasp_types`` writes
``docs/grasp_types.json`` for the tables of the page.

Every type is run on the same held-out seeds, which no search has used, in every engine and body, on
the nominal hand and on randomized ones. The file contains a fingerprint of the data: a test fails
if the data has changed since."""

import hashlib
import json
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from PIL import Image

from experiments.agree import VARIATIONS, parsed
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.pictures import VIEW, VIEW_CENTRE, Portrait, contact_sheet
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.model import POSTURES
from hpac_gym.output import markdown, replacing, write_text
from hpac_gym.physics.engine import PARTS
from hpac_gym.physics.simulation import SET_UPS
from hpac_gym.policies.loading import load_policy
from hpac_gym.progress import progress
from hpac_gym.tasks.grasp_rules import GRASP_TYPES, data_text
from tools.type_trials import run_types

RESULTS = Path(__file__).parents[1] / "docs" / "grasp_types.json"
HANDS = ("nominal", "hand", "full")


def fingerprint(name: str) -> str:
    """Fingerprint of the data that determines a type's results: its posture and its entry in the
    file of types.
    """
    entry = data_text().split(f"[{name}]\n")[1].split("\n[")
    body = "[".join(
        part for index, part in enumerate(entry) if index == 0 or part.startswith(f"{name}.")
    )
    return hashlib.sha256(
        POSTURES[name].target_joint_pos.tobytes() + body.strip().encode()
    ).hexdigest()[:16]


def judge(name: str, set_up: str, hand: str, episodes: int) -> dict[str, Any]:
    """Run episodes of one type in one set-up; returns successes, holds, failed clauses and
    contacting parts.
    """
    engine, body, world = parsed(set_up)
    seeds = [HELD_OUT_SEED + index for index in range(episodes)]
    found = run_types(
        [GRASP_TYPES[name]] * episodes,
        seeds,
        engine=engine,
        body=body,
        randomize=hand,
        world=world,
    )
    trials = [trial for _, trial in found]
    wins = [trial for trial in trials if trial.success]
    failed = Counter(
        clause
        for trial in trials
        if trial.held
        for clause, kept in trial.clauses.items()
        if kept < 1
    )

    def mean(what: str) -> dict[str, float]:
        return {
            part: round(float(np.mean([getattr(trial, what)[part] for trial in wins])), 2)
            for part in (PARTS if wins else ())
        }

    return {
        "episodes": episodes,
        "held": sum(trial.held for trial in trials),
        "successes": len(wins),
        "in_touch_at_the_start": sum(not trial.free for trial in trials),
        "failed_clauses_of_held": dict(failed.most_common()),
        "touched": mean("touched"),
        "force_newton": mean("force"),
    }


def results() -> dict[str, Any]:
    """Contents of the file, by type."""
    return json.loads(RESULTS.read_text(encoding="utf-8"))


def rule_table() -> str:
    """Table of the objects, descriptions and rules of the grasp types."""
    rows = []
    for name, kind in GRASP_TYPES.items():
        words = "; ".join(words for words, *_ in kind.rule.terms())
        rows.append(
            [
                f"`{name}`",
                str(POSTURES[name].panel),
                kind.start.object.about,
                kind.start.about,
                words,
            ]
        )
    return markdown(["grasp", "panel", "object", "held as", "rule"], rows)


def all_successes_table() -> str:
    """Successes with every kind of hands, in the order of `SET_UPS`, and the episodes of each."""
    outcomes = results()
    parts = {f"`{name}`": [entry] for name, entry in outcomes.items()}
    parts["all"] = list(outcomes.values())
    rows = []
    for label, entries in parts.items():
        counts = [
            [sum(entry[hand][set_up]["successes"] for entry in entries) for set_up in SET_UPS]
            for hand in HANDS
        ]
        rows.append([label, *(", ".join(map(str, of_set_up)) for of_set_up in counts)])
    first = parts["all"][0]
    heads = [f"{hand}, of {first[hand][SET_UPS[0]]['episodes']}" for hand in HANDS]
    return markdown(["grasp", *heads], rows)


def picture(path: Path) -> None:
    """Draw each type at the end of its first held-out episode in MuJoCo that succeeds."""
    portraits = {}
    for name, kind in progress(GRASP_TYPES.items(), "pictures"):
        longest = 2 * max(kind.start.object.half_extents)
        view = replace(
            VIEW, width=2 * VIEW.width, height=2 * VIEW.height, distance=0.36 + 0.8 * longest
        )
        with gymnasium.make(
            "HPAC-GraspType-v0",
            types=name,
            wrist="script",
            engine="mujoco",
            render_mode="rgb_array",
        ) as env:
            policy = load_policy("scripted", env)
            for seed in range(HELD_OUT_SEED, HELD_OUT_SEED + 100):
                *_, last = run_episodes(single(env), [policy], [seed])
                if last.success:
                    break
            pixels = Image.fromarray(env.unwrapped.picture(view, VIEW_CENTRE))
            pixels = pixels.resize((VIEW.width, VIEW.height), Image.Resampling.LANCZOS)
            portraits[name] = Portrait(np.asarray(pixels), last.success)
    with replacing(path) as temporary:
        contact_sheet(portraits).save(temporary, format="PNG", optimize=True)


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("tools.grasp_types", __doc__)
    parser.add_argument(
        "--types", nargs="+", default=list(GRASP_TYPES), choices=list(GRASP_TYPES), metavar="NAME"
    )
    parser.add_argument(
        "-n",
        "--episodes",
        type=whole_number(1),
        default=20,
        help="per type on the nominal hand",
    )
    parser.add_argument(
        "-m",
        "--randomized",
        type=whole_number(1),
        default=10,
        help="per type with randomization",
    )
    parser.add_argument("--hands", nargs="+", default=list(HANDS), choices=HANDS)
    parser.add_argument(
        "--set-ups",
        nargs="+",
        default=list(SET_UPS),
        metavar="ENGINE/BODY",
        choices=[*SET_UPS, *(f"{set_up}/{name}" for set_up in SET_UPS for name in VARIATIONS)],
        help="engines and bodies; ENGINE/BODY/VARIATION, physics as of experiments.agree, is printed alone",
    )
    parser.add_argument("--out", type=Path, default=RESULTS, help="file to update")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw all types instead")
    options = parser.parse_args(argv)
    if options.picture:
        picture(options.picture)
        return
    outcomes = json.loads(options.out.read_text(encoding="utf-8")) if options.out.exists() else {}
    cells = [
        (name, set_up, hand)
        for name in options.types
        for hand in options.hands
        for set_up in options.set_ups
    ]
    for name, set_up, hand in progress(cells, "types"):
        entry = outcomes.setdefault(name, {})
        count = options.episodes if hand == "nominal" else options.randomized
        if entry.get("data") != fingerprint(name):
            entry.clear()
            entry["data"] = fingerprint(name)  # results for other data are invalid
        row = judge(name, set_up, hand, count)
        print(
            f"{name} {hand} {set_up}: {row['successes']} of {row['episodes']}, held {row['held']}, "
            f"in touch {row['in_touch_at_the_start']} {row['failed_clauses_of_held']}",
            flush=True,
        )
        if set_up not in SET_UPS:
            continue
        entry.setdefault(hand, {})[set_up] = row
        ordered = {name: outcomes[name] for name in GRASP_TYPES if name in outcomes}
        write_text(options.out, json.dumps(ordered, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(run(main))
