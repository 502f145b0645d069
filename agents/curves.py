"""Pictures and tables of a run: ``python -m agents.curves runs/NAME``.

Reads ``progress.csv`` and ``results.json`` of the folder; writes ``learning_curve.png`` and
``results.md`` to it. Missing input is skipped."""

import csv
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents import RunError
from agents.progress import COLUMNS, CURVE
from hpac_gym.command import command_parser, run
from hpac_gym.evaluation.evaluate import table
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.figures import new_figure, save
from hpac_gym.output import write_text

RESULTS = "results.json"
PAGE = "results.md"
PICTURE = "learning_curve.png"
COLOURS = {"learned": "#1b6ca8", "scripted": "#c98a1b", "random": "#8a8a8a"}


def read_curve(path: Path) -> dict[str, np.ndarray]:
    """Read the columns by name.

    Raises:
        RunError: The file is missing or not a learning curve.
    """
    try:
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        return {name: np.array([float(row[name]) for row in rows]) for name in COLUMNS}
    except OSError as error:
        raise RunError(f"cannot read '{path}': {error.strerror or error}") from None
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise RunError(f"'{path}' is not a learning curve: {error!r}") from None


def draw(path: Path, curve: dict[str, np.ndarray], results: dict[str, Any] | None) -> None:
    """Draw the success in training over trials, with the held-out results of every policy, and all
    Wilson 95 % intervals.
    """
    # Imported here, since a command that only parses its arguments does not need it.
    from matplotlib.ticker import MaxNLocator

    figure = new_figure(8, 4.5)
    axes = figure.add_subplot()
    axes.plot(
        curve["episodes"] / 1000,
        100 * curve["success_rate"],
        color=COLOURS["learned"],
        label="learning, with exploration",
    )
    counts = zip(np.rint(curve["success_rate"] * curve["window"]), curve["window"], strict=True)
    low, high = (
        100 * np.reshape([wilson_interval(held, trials) for held, trials in counts], (-1, 2)).T
    )
    axes.fill_between(
        curve["episodes"] / 1000, low, high, color=COLOURS["learned"], alpha=0.3, linewidth=0
    )
    for name, numbers in (results or {}).get("policies", {}).items():
        low, high = (100 * bound for bound in numbers["interval_95"])
        label = f"{name}, {numbers['episodes']} held-out episodes: {numbers['success_rate']:.0%}"
        axes.axhspan(low, high, color=COLOURS.get(name), alpha=0.18, linewidth=0)
        axes.axhline(
            100 * numbers["success_rate"],
            color=COLOURS.get(name),
            linestyle="--",
            linewidth=1,
            label=label,
        )
    axes.set(xlabel="trials (thousands)", ylabel="success (%)", ylim=(-2, 102))
    axes.set_xlim(0, curve["episodes"].max(initial=1) / 1000)
    if len(curve["seconds"]) > 1:
        trials = np.append(0, curve["episodes"] / 1000)
        minutes = np.append(0, curve["seconds"] / 60)
        # Trials and minutes both increase monotonically, so each can be interpolated from the
        # other.
        axis = axes.secondary_xaxis(
            "top",
            (lambda x: np.interp(x, trials, minutes), lambda t: np.interp(t, minutes, trials)),
        )
        axis.set_xticks(
            [tick for tick in MaxNLocator(8).tick_values(0, minutes[-1]) if tick <= minutes[-1]]
        )
        axis.set_xlabel("training time (minutes)")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize="small")
    save(figure, path, picture=True)


def draw_trials(path: Path, cells: Sequence[dict[str, Any]]) -> None:
    """Draw success, with its Wilson 95 % interval, over trials: of single runs, and of those with
    the trials of several.
    """
    from matplotlib.ticker import LogLocator  # imported here, since a table does not need it

    figure = new_figure(8, 4.5)
    axes = figure.add_subplot()
    for label, style, colour in (
        ("of one run", "o", "random"),
        ("of several runs", "o-", "learned"),
    ):
        shown = [
            (c["trained"]["episodes"], c["success_rate"], *c["interval_95"])
            for c in cells
            if c["trials"] == label
        ]
        trials, *rates = np.reshape(sorted(shown), (-1, 4)).T
        rate, low, high = (100 * each for each in rates)
        bars = (rate - low, high - rate)
        axes.errorbar(
            trials, rate, bars, fmt=style, alpha=0.7, label=f"trials {label}", color=COLOURS[colour]
        )
    axes.set(xscale="log", xlabel="number of trials", ylabel="success (%)")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 4)))
    axes.xaxis.set_major_formatter(lambda trials, _: f"{trials:,.0f}")
    axes.xaxis.set_minor_formatter("")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    save(figure, path, picture=True)


def report(folder: Path) -> list[Path]:
    """Write the pictures and tables of a run and return the files.

    Raises:
        RunError: The folder has no results, or they cannot be read.
        OutputError: The folder cannot be written.
    """
    results = None
    written = []
    if (folder / RESULTS).exists():
        try:
            results = json.loads((folder / RESULTS).read_text())
            page = _page(results)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise RunError(f"cannot read '{folder / RESULTS}': {error!r}") from None
        write_text(folder / PAGE, page)
        written.append(folder / PAGE)
    if (folder / CURVE).exists():
        draw(folder / PICTURE, read_curve(folder / CURVE), results)
        written.append(folder / PICTURE)
    if not written:
        raise RunError(f"nothing to show in '{folder}': it has neither {CURVE} nor {RESULTS}")
    return written


def _page(results: dict[str, Any]) -> str:
    text = f"# {results['env_id'].rpartition(':')[2]}\n\n{table(results)}\n"
    if policy := results.get("policy"):
        text += f"\nLearned: {policy['file']}, "
        if "seconds" in policy:
            effort = f"{policy['episodes']:,} trials in {policy['seconds'] / 60:.1f} minutes"
            text += f"{policy['algorithm']}, {effort}, run seed {policy['settings']['seed']}, "
        text += f"weights SHA-256 `{policy.get('sha256', policy.get('weights_sha256'))[:16]}…`.\n"
    return (
        text
        + f"\nAll policies were run on the same episodes, seeds {results['first_seed']} to {results['last_seed']}.\n"
    )


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("agents.curves", __doc__)
    parser.add_argument("folder", type=Path, help="folder of a run")
    for path in report(parser.parse_args(argv).folder):
        print(path)


if __name__ == "__main__":
    sys.exit(run(main))
