"""Whether a forecast from one sweep holds: ``python -m experiments.forecast``.

Hidden hands of a workshop with slack are swept once in simulation, and get what `hpac calibrate` writes:
a hand file, and virtual hands beside it. `hpac forecast`'s function predicts the success of a grasp in
1,000 episodes from the virtual hands, and then the hidden hand runs 1,000. Controls: the forecast of
another hidden hand; and, as if there were no sweep, virtual hands that are all the nominal one, and
other hands of the same workshop.

Files and rows are kept, and a later run continues them."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.chain import slack_hand, swept
from experiments.results import add_out, read_results, write_results
from hpac_gym.calibration.calibrate import named
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.posterior import draws_text, read_draws, report_folder
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.evaluation.evaluate import run_block
from hpac_gym.evaluation.forecast import forecast
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.model import HPAC, Hand, hand_to_toml, load_hand
from hpac_gym.output import markdown, write_text
from hpac_gym.progress import progress
from hpac_gym.registration import GRASP

FILES = Path("runs/forecast")
FIRST_HAND = 1_000
"""The seeds of the hidden hands; `experiments.chain` uses those from 0 on, and the grasps below were
chosen on the hands 500 to 511.
"""
OTHERS = 2_000
"""The seeds of the other hands of the workshop."""
TRUTH = 1_000
TRUTH_SEED = 10_000_000
FORECAST_SEED = 20_000_000
EPISODES = 50
"""Of each virtual hand."""
WIDTH = 0.10
"""Widest interval that counts."""
SWEEP = "of the sweep"


CASE = "lateral_pinch, nominal map"
"""A pinch that many of the hands miss with the nominal map, but not all."""
OPTIONS = {"grasp": "lateral_pinch", "engine": "mujoco", "model": HPAC}
VIRTUAL = 20
"""Virtual hands of a forecast."""


def predicted(hands: Sequence[Hand], seed: int) -> dict[str, Any]:
    """The forecast of virtual hands, on episodes that no hidden hand sees."""
    return forecast(hands, "scripted", GRASP, OPTIONS, EPISODES, of=TRUTH, seed_start=seed)


def calibrated(seed: int) -> Path:
    """The hand file of a hidden hand's sweep, with the virtual hands beside it."""
    path = FILES / f"{seed}.toml"
    if not path.exists():
        identified = identify(swept(slack_hand(seed), seed), hold_out=True, draws=50)
        write_text(report_folder(path) / "draws.json", draws_text(identified.hand, identified))
        write_text(path, hand_to_toml(named(identified, HPAC, f"the sweep of hand {seed}")))
    return path


def row_of(seed: int) -> dict[str, Any]:
    """Forecast and truth of one hidden hand."""
    path = calibrated(seed)
    place = 10_000 * (seed - FIRST_HAND)
    told = predicted(read_draws(path, load_hand(path))[:VIRTUAL], FORECAST_SEED + place)
    seeds = range(TRUTH_SEED + place, TRUTH_SEED + place + TRUTH)
    options = OPTIONS | {"hand": slack_hand(seed)}
    won = sum(episode.success for (episode,) in run_block(["scripted"], GRASP, options, seeds))
    return {"case": CASE, "seed": seed, "truth": won / TRUTH, **told}


def controls() -> dict[str, dict[str, Any]]:
    """The forecasts that know no sweep: nominal hands, and other hands of the workshop."""
    others = [slack_hand(OTHERS + number) for number in range(VIRTUAL)]
    return {
        "all nominal": predicted([HPAC] * VIRTUAL, 2 * FORECAST_SEED),
        "others of the workshop": predicted(others, 3 * FORECAST_SEED),
    }


def summary(
    rows: Sequence[dict[str, Any]], without: dict[str, dict[str, Any]]
) -> list[dict[str, Any]]:
    """How many intervals hold the truth and are no wider than `WIDTH`, by case and forecast."""
    cells = []
    for case, unknowing in without.items():
        mine = [row for row in rows if row["case"] == case]
        truth = np.array([row["truth"] for row in mine])
        kinds = {SWEEP: mine, "of the next hand's sweep": mine[1:] + mine[:1]}
        kinds |= {kind: [one] * len(mine) for kind, one in unknowing.items()}
        for kind, forecasts in kinds.items():
            low, high = np.array([one["interval_95"] for one in forecasts]).T
            inside = (low <= truth) & (truth <= high)
            good = int((inside & (high - low <= WIDTH)).sum())
            cells.append(
                {
                    "case": case,
                    "virtual_hands": kind,
                    "hands": len(mine),
                    "inside": int(inside.sum()),
                    "inside_and_narrow": good,
                    "inside_and_narrow_95": wilson_interval(good, len(mine)),
                    "width": [float(np.median(high - low)), float((high - low).max())],
                    "truth": np.quantile(truth, (0, 0.25, 0.5, 0.75, 1)).tolist(),
                }
            )
    return cells


def table(cells: Sequence[dict[str, Any]]) -> str:
    """The cells as a table in Markdown."""
    head = (
        "grasp, commanded with",
        "virtual hands",
        "hold the truth",
        "and ≤ 10 points",
        "width: median, largest",
    )
    return markdown(
        head,
        [
            (
                cell["case"],
                cell["virtual_hands"],
                f"{cell['inside']} of {cell['hands']}",
                cell["inside_and_narrow"],
                ", ".join(f"{100 * width:.1f}" for width in cell["width"]),
            )
            for cell in cells
        ],
    )


def main(argv: list[str] | None = None) -> None:
    """Continue the file row by row, and print the table of the rows that it has."""
    parser = command_parser("experiments.forecast", __doc__)
    parser.add_argument("--hands", type=whole_number(1), default=40, help="hidden hands")
    add_out(parser)
    arguments = parser.parse_args(argv)
    text: dict[str, Any] = {"without_a_sweep": {}, "rows": []}
    if arguments.out.exists():
        text = read_results(arguments.out, *text)
    rows = text["rows"]
    without = text["without_a_sweep"]
    known = {row["seed"] for row in rows}
    seeds = range(FIRST_HAND, FIRST_HAND + arguments.hands)
    wanted = [seed for seed in seeds if seed not in known]
    for seed in progress(wanted, "hidden hands"):
        if CASE not in without:
            without[CASE] = controls()
        rows.append(row_of(seed))
        told = {"cells": summary(rows, without), "without_a_sweep": without, "rows": rows}
        write_results(arguments.out, f"forecast --hands {len(rows)}", **told)
    print(table(summary(rows, without)))


if __name__ == "__main__":
    sys.exit(run(main))
