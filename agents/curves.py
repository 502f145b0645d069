"""Pictures and tables of a run: ``python -m agents.curves runs/NAME``.

Reads ``progress.csv`` and ``results.json`` of the folder; writes ``learning_curve.png`` and
``results.md`` to it. Missing input is skipped. A training writes its learning curve, a row every
five hundred trials, and its progress bar with `Progress`."""

import csv
import json
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from agents import RunError
from hpac_gym.command import command_parser, run
from hpac_gym.evaluation.evaluate import table
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.output import replacing, write_text

RESULTS = "results.json"
CURVE = "progress.csv"
PAGE = "results.md"
BOARD = "tensorboard"
PICTURE = "learning_curve.png"
COLOURS = {"learned": "#1b6ca8", "scripted": "#c98a1b", "random": "#8a8a8a"}
COLUMNS = ("episodes", "seconds", "success_rate", "window", "entropy")
ROW_EVERY = 500  # trials per row of the learning curve
WINDOW = 1_000  # trials over which the success rate is averaged
LINE_EVERY_S = 30.0  # interval of progress lines if standard error is not a terminal [s]


class Progress:
    """Shows the progress of a training and writes its learning curve to a folder.

    Args:
        episodes, most_steps: limits of the trials and of the control steps over all worlds.
        done, env_steps, seconds_before: trials, control steps and time [s] of the run before it was
        resumed. time_limit: latest end of the training, relative to `started` [s]. started: start
        of the training on the clock [s]; None means now. clock: function that returns the time [s].

    Attributes:
        done, env_steps: trials and control steps so far, over all worlds.
        stopped_by: why the training ends after the current step; None if it goes on.
    """

    def __init__(
        self,
        folder: Path,
        episodes: int,
        most_steps: int,
        done: int = 0,
        env_steps: int = 0,
        seconds_before: float = 0.0,
        time_limit: float = float("inf"),
        started: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.done = done
        self.env_steps = env_steps
        self.stopped_by = None
        self._curve = folder / CURVE
        self._board = board_of(folder, done)
        self._first = done
        self._most = episodes
        self._most_steps = most_steps
        self._seconds_before = seconds_before
        self._time_limit = time_limit
        self._clock = clock
        self._started = clock() if started is None else started
        self._held: deque[bool] = deque(maxlen=WINDOW)
        self._written = done
        self._next_line = LINE_EVERY_S / 3
        self._bar = tqdm(
            total=100,
            desc="training",
            disable=not sys.stderr.isatty(),
            dynamic_ncols=True,
            bar_format="{desc} {percentage:3.0f}% |{bar}| {elapsed} of {remaining} more{postfix}",
        )

    @property
    def seconds(self) -> float:
        """Training time of this run so far, including earlier parts [s]."""
        return self._seconds_before + self._clock() - self._started

    @property
    def share(self) -> float:
        """Completed share of the training, 0…1, by trials, steps or time limit."""
        spent = self.seconds / (self._seconds_before + self._time_limit)
        return min(1.0, max(self.done / self._most, self.env_steps / self._most_steps, spent))

    @property
    def success_rate(self) -> float:
        """Share of the last trials that held; NaN before the first one has ended."""
        return sum(self._held) / len(self._held) if self._held else float("nan")

    def add(self, held: list[bool], steps: int, metrics: Callable[[], Mapping[str, float]]) -> bool:
        """Record trials and control steps, and from time to time the metrics of the learner;
        returns whether the training continues.
        """
        held = held[: self._most - self.done]  # the run keeps no more
        self._held.extend(held)
        self.done += len(held)
        self.env_steps += steps
        if self.done >= self._written + ROW_EVERY:
            self.write_row(metrics())
        if self._clock() - self._started > self._time_limit:
            self.stopped_by = "time limit"
        self._show()
        return self.stopped_by is None and self.done < self._most

    def close(self) -> None:
        """Close the progress bar and the file for TensorBoard."""
        self._bar.close()
        if self._board is not None:
            self._board.close()

    def write_row(self, metrics: Mapping[str, float]) -> None:
        """Write a row of the learning curve, and all metrics for TensorBoard, unless there was no
        trial since the last one.

        Raises:
            RunError: The file cannot be written, or the disk is full.
        """
        if self.done == self._written:
            return
        self._written = self.done
        row = (
            self.done,
            round(self.seconds, 1),
            round(self.success_rate, 4),
            len(self._held),
            round(metrics.get("entropy", float("nan")), 3),
        )
        try:
            with self._curve.open("a", newline="") as file:
                csv.writer(file).writerows([row] if file.tell() else [COLUMNS, row])
        except OSError as error:
            raise RunError(f"cannot write '{self._curve}': {error.strerror or error}") from error
        if self._board is not None:
            shown = {"success_rate": self.success_rate, **metrics}
            for name, value in shown.items():
                self._board.add_scalar(f"train/{name}", value, self.done)
            self._board.flush()

    def _show(self) -> None:
        elapsed = self._clock() - self._started
        if self._bar.disable and elapsed < self._next_line:
            return
        self._next_line = elapsed + LINE_EVERY_S
        success = (
            f"{self.success_rate:.0%} of the last {len(self._held)} held"
            if self._held
            else "none ended"
        )
        text = f"{self.done:,} trials, {(self.done - self._first) / max(elapsed, 1e-9):.0f}/s, {success}"
        if self._bar.disable:
            print(
                f"training {self.share:4.0%} {elapsed / 60:5.1f} min, {text}",
                file=sys.stderr,
                flush=True,
            )
        else:
            self._bar.set_postfix_str(text, refresh=False)
            self._bar.update(100 * self.share - self._bar.n)


def board_of(folder: Path, done: int) -> Any:
    """What writes for TensorBoard into a folder, from a number of trials on; None if it is not
    installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(folder / BOARD, purge_step=done + 1)


def drop_rows_after(path: Path, episodes: int) -> None:
    """Remove rows that an interrupted training wrote after its last checkpoint, including an
    incomplete one.

    Raises:
        RunError: The file is not a learning curve.
    """
    if not path.exists():
        return
    try:
        header, *rows = path.read_text().splitlines(keepends=True) or [""]
        kept = [row for row in rows if row.endswith("\n") and int(row.split(",")[0]) <= episodes]
    except (OSError, ValueError) as error:
        raise RunError(f"'{path}' is not a learning curve: {error}") from None
    write_text(path, "".join([header, *kept]))


def read_curve(path: Path) -> dict[str, np.ndarray]:
    """Read the columns by name.

    Raises:
        RunError: The file is missing or not a learning curve.
    """
    try:
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        curve = {name: np.array([float(row[name]) for row in rows]) for name in COLUMNS}
        rate = curve["success_rate"]
        window = curve["window"]
        if not (
            np.isfinite(curve["seconds"]).all()
            and ((rate >= 0) & (rate <= 1) & (window >= 1)).all()
        ):
            raise ValueError("a row has no time, no trial, or a rate of success outside 0…1")
        return curve
    except OSError as error:
        raise RunError(f"cannot read '{path}': {error.strerror or error}") from None
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise RunError(f"'{path}' is not a learning curve: {error!r}") from None


def draw(path: Path, curve: dict[str, np.ndarray], results: dict[str, Any] | None) -> None:
    """Draw the success in training over trials, with the held-out results of every policy, and all
    Wilson 95 % intervals.
    """
    # Imported here, since a command that only parses its arguments does not need it.
    from matplotlib.figure import (
        Figure,
    )
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(8, 4.5), layout="constrained")
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
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


def draw_trials(path: Path, cells: Sequence[dict[str, Any]]) -> None:
    """Draw success, with its Wilson 95 % interval, over trials: of single runs, and of those with
    the trials of several.
    """
    from matplotlib.figure import Figure  # imported here, since a table does not need it
    from matplotlib.ticker import LogLocator

    figure = Figure(figsize=(8, 4.5), layout="constrained")
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
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


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


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("agents.curves", __doc__)
    parser.add_argument("folder", type=Path, help="folder of a run")
    for path in report(parser.parse_args(argv).folder):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
