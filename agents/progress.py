"""Progress of a training: the progress bar and the learning curve, a CSV file that gets a row every five hundred trials."""

import csv
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
from tqdm import tqdm

from agents.command import RunError

CURVE = "progress.csv"
COLUMNS = ("episodes", "seconds", "success_rate", "window", "entropy")
ROW_EVERY = 500
"""Trials per row of the learning curve."""
WINDOW = 1_000
"""Trials over which the success rate is averaged."""
LINE_EVERY_S = 30.0
"""Interval of progress lines if standard error is not a terminal [s]."""


class Progress:
    """Shows the progress of a training and writes its learning curve.

    Args:
        folder: folder of the run.
        episodes: total number of trials.
        env_steps: limit of control steps over all worlds.
        done, steps_done: trials and control steps of the run before it was resumed.
        seconds_before: time that these took [s].
        time_limit: latest end of the training, relative to `started` [s].
        started: start of the training on the clock [s]; None means now.
        clock: function that returns the time [s].

    Attributes:
        done: trials so far.
        env_steps: control steps so far, over all worlds.
        stopped_by: why the training was stopped; None if it was not.
    """

    def __init__(
        self, folder: Path, episodes: int, env_steps: int, done: int = 0, steps_done: int = 0, seconds_before: float = 0.0,
        time_limit: float = float("inf"), started: float | None = None, clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self.stopped_by: str | None = None
        self._curve, self._episodes, self.done, self._first = folder / CURVE, episodes, done, done
        self._seconds_before, self._time_limit = seconds_before, time_limit
        self._env_steps, self.env_steps = env_steps, steps_done
        self._clock, self._started = clock, clock() if started is None else started
        self._held: deque[bool] = deque(maxlen=WINDOW)
        self._written, self._next_row, self._next_line = done or -1, done + ROW_EVERY, LINE_EVERY_S / 3
        self._bar = tqdm(
            total=100, desc="training", disable=not sys.stderr.isatty(), dynamic_ncols=True,
            bar_format="{desc} {percentage:3.0f}% |{bar}| {elapsed} of {remaining} more{postfix}",
        )  # fmt: skip

    @property
    def seconds(self) -> float:
        """Training time of this run so far, including earlier parts [s]."""
        return self._seconds_before + self._clock() - self._started

    @property
    def share(self) -> float:
        """Completed share of the training, 0…1, by trials, steps or time limit."""
        spent = self.seconds / (self._seconds_before + self._time_limit)
        return min(1.0, max(self.done / self._episodes, self.env_steps / self._env_steps, spent))

    def stop(self, reason: str) -> None:
        """End the training after the current step."""
        self.stopped_by = reason

    def add(self, held: list[bool], steps: int, entropy: float) -> bool:
        """Record trials, control steps and the actor's entropy [nats per number]; returns whether the training continues."""
        self._held.extend(held)
        self.done += len(held)
        self.env_steps += steps
        if self.done >= self._next_row:
            self.write_row(entropy)
        if self._clock() - self._started > self._time_limit:
            self.stop("time limit")
        self._show()
        return self.stopped_by is None and self.done < self._episodes

    def close(self) -> None:
        """Close the progress bar."""
        self._bar.close()

    def write_row(self, entropy: float) -> None:
        """Write a row of the learning curve, unless it was written already."""
        if self.done == self._written:
            return
        self._written, self._next_row = self.done, self.done + ROW_EVERY
        rate = sum(self._held) / len(self._held) if self._held else float("nan")
        row = {"episodes": self.done, "seconds": round(self.seconds, 1), "success_rate": round(rate, 4)}
        append_row(self._curve, row | {"window": len(self._held), "entropy": round(entropy, 3)})

    def _show(self) -> None:
        elapsed = self._clock() - self._started
        if self._bar.disable and elapsed < self._next_line:
            return
        self._next_line = elapsed + LINE_EVERY_S
        success = f"{sum(self._held) / len(self._held):.0%} of the last {len(self._held)} held" if self._held else "none ended"
        text = f"{self.done:,} trials, {(self.done - self._first) / max(elapsed, 1e-9):.0f}/s, {success}"
        if self._bar.disable:
            print(f"training {self.share:4.0%} {elapsed / 60:5.1f} min, {text}", file=sys.stderr, flush=True)
        else:
            self._bar.set_postfix_str(text, refresh=False)
            self._bar.update(100 * self.share - self._bar.n)


def append_row(path: Path, row: dict[str, float | int]) -> None:
    """Append a row, with the header if the file is new.

    Raises:
        RunError: The file cannot be written, or the disk is full.
    """
    try:
        with path.open("a", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            if file.tell() == 0:
                writer.writeheader()
            writer.writerow(row)
    except OSError as error:
        raise RunError(f"cannot write '{path}': {error.strerror or error}") from error


def drop_rows_after(path: Path, episodes: int) -> None:
    """Remove rows that an interrupted training wrote after its last checkpoint, including an incomplete one."""
    if not path.exists():
        return
    header, *rows = path.read_text().splitlines(keepends=True) or [""]
    kept = [row for row in rows if row.endswith("\n") and int(row.split(",")[0]) <= episodes]
    path.write_text("".join([header, *kept]))


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
    except (KeyError, TypeError, ValueError) as error:
        raise RunError(f"'{path}' is not a learning curve: {error!r}") from None
