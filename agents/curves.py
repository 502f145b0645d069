"""Pictures and tables of a run: ``python -m agents.curves runs/NAME``.

Reads ``progress.csv`` and ``results.json`` of the folder; writes ``learning_curve.png`` and ``results.md`` to it. Missing
input is skipped.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from agents.command import RunError, command_parser
from agents.evaluate import table
from agents.progress import CURVE, read_curve
from hpac import run
from hpac_gym.output import replacing, write_text

RESULTS = "results.json"
COLOURS = {"learned": "#1b6ca8", "scripted": "#c98a1b", "random": "#8a8a8a"}


def learning_curve(curve: dict[str, np.ndarray], results: dict[str, Any] | None = None) -> Figure:
    """Success in training over trials, with the held-out results of every policy."""
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot(curve["episodes"] / 1000, 100 * curve["success_rate"], color=COLOURS["learned"], label="learning, with exploration")
    for name, numbers in (results or {}).get("policies", {}).items():
        low, high = (100 * bound for bound in numbers["interval_95"])
        label = f"{name}, {numbers['episodes']} held-out episodes: {numbers['success_rate']:.0%}"
        axes.axhspan(low, high, color=COLOURS.get(name), alpha=0.18, linewidth=0)
        axes.axhline(100 * numbers["success_rate"], color=COLOURS.get(name), linestyle="--", linewidth=1, label=label)
    axes.set(xlabel="trials (thousands)", ylabel="success (%)", ylim=(-2, 102))
    axes.set_xlim(0, curve["episodes"].max(initial=1) / 1000)
    if len(curve["seconds"]) > 1:
        trials, minutes = np.append(0, curve["episodes"] / 1000), np.append(0, curve["seconds"] / 60)
        # Trials and minutes both increase monotonically, so each can be interpolated from the other.
        axis = axes.secondary_xaxis("top", (lambda x: np.interp(x, trials, minutes), lambda t: np.interp(t, minutes, trials)))
        axis.set_xticks([tick for tick in MaxNLocator(8).tick_values(0, minutes[-1]) if tick <= minutes[-1]])
        axis.set_xlabel("training time (minutes)")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize="small")
    return figure


def report(folder: Path) -> list[Path]:
    """Write the pictures and tables of a run and return the files.

    Raises:
        RunError: The folder has no results, or they cannot be read.
        OutputError: The folder cannot be written.
    """
    results = _read_results(folder / RESULTS)
    written = []
    if results is not None:
        write_text(folder / "results.md", _page(results))
        written.append(folder / "results.md")
    if (folder / CURVE).exists():
        _save(learning_curve(read_curve(folder / CURVE), results), folder / "learning_curve.png")
        written.append(folder / "learning_curve.png")
    if not written:
        raise RunError(f"nothing to show in '{folder}': it has neither {CURVE} nor {RESULTS}")
    return written


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("agents.curves", __doc__)
    parser.add_argument("folder", type=Path, help="folder of a run")
    for path in report(parser.parse_args(argv).folder):
        print(path)
    return 0


def _page(results: dict[str, Any]) -> str:
    text = f"# {results['env_id'].rpartition(':')[2]}\n\n{table(results)}\n"
    if policy := results.get("policy"):
        text += f"\nLearned: {policy['file']}, "
        if "seconds" in policy:
            effort = f"{policy['episodes']:,} trials in {policy['seconds'] / 60:.1f} minutes"
            text += f"{policy['algorithm']}, {effort}, run seed {policy['settings']['seed']}, "
        text += f"weights SHA-256 `{policy.get('sha256', policy.get('weights_sha256'))[:16]}…`.\n"
    return text + f"\nAll policies were run on the same episodes, seeds {results['first_seed']} to {results['last_seed']}.\n"


def _read_results(path: Path) -> dict[str, Any] | None:
    try:
        results = json.loads(path.read_text())
        results["policies"], results["differences"], results["env_id"]
        return results
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"cannot read '{path}': {error!r}") from None


def _save(figure: Figure, path: Path) -> None:
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


if __name__ == "__main__":
    sys.exit(run(main))
