"""The progress of a training: a bar or lines on standard error, a learning curve in the folder of the
run, metrics for TensorBoard."""

import csv
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tqdm import tqdm

from agents import RunError
from hpac_gym.output import write_text, writing

CURVE = "progress.csv"
BOARD = "tensorboard"
COLUMNS = ("episodes", "seconds", "success_rate", "window", "entropy")
ROW_EVERY = 500  # trials per row of the learning curve
WINDOW = 1_000  # trials over which the success rate is averaged
LINE_EVERY_S = 30.0  # interval of progress lines if standard error is not a terminal [s]


def _in_thread(error: Any, before: Callable[[Any], Any] = threading.excepthook) -> None:
    """Tell an error of a thread, unless it is that of TensorBoard, whose errors `Progress` raises."""
    if not type(error.thread).__module__.startswith("tensorboard"):
        before(error)


threading.excepthook = _in_thread


class Progress:
    """Shows the progress of a training and writes its learning curve to a folder.

    Args:
        episodes, most_steps: limits of the trials and of the control steps over all worlds.
        done, env_steps, seconds_before: trials, control steps and time [s] of the run before it was
        resumed.
        time_limit: longest time of the training from now on [s].
        clock: function that returns the time [s].

    Raises:
        OutputError: The folder cannot be written, or the disk is full.

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
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        # Imported here, since it takes seconds.
        from torch.utils.tensorboard import SummaryWriter

        self.done = done
        self.env_steps = env_steps
        self.stopped_by = None
        self._curve = folder / CURVE
        with writing(folder / BOARD):
            self._board = SummaryWriter(folder / BOARD, purge_step=done + 1)
        self._first = done
        self._most = episodes
        self._most_steps = most_steps
        self._seconds_before = seconds_before
        self._time_limit = time_limit
        self._clock = clock
        self._started = clock()
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
        """Completed share of the training, 0…1, by trials or steps, or in a new run by time limit:
        that of a resumed one would end its exploration at once.
        """
        spent = 0.0 if self._first else self.seconds / self._time_limit
        return min(1.0, max(self.done / self._most, self.env_steps / self._most_steps, spent))

    @property
    def success_rate(self) -> float:
        """Share of the last trials that held; NaN before the first one has ended."""
        return sum(self._held) / len(self._held) if self._held else float("nan")

    @property
    def going(self) -> bool:
        """Whether the training continues."""
        return self.stopped_by is None and self.done < self._most

    def add(self, held: list[bool], steps: int, metrics: Callable[[], Mapping[str, float]]) -> None:
        """Record trials and control steps, and from time to time the metrics of the learner."""
        held = held[: self._most - self.done]  # the run keeps no more
        self._held.extend(held)
        self.done += len(held)
        self.env_steps += steps
        if self.done >= self._written + ROW_EVERY:
            self.write_row(metrics())
        if self._clock() - self._started > self._time_limit:
            self.stopped_by = "time limit"
        self._show()

    def close(self) -> None:
        """Close the progress bar and the file for TensorBoard.

        Raises:
            OutputError: The disk is full.
        """
        self._bar.close()
        with writing(self._board.log_dir):
            self._board.close()

    def write_row(self, metrics: Mapping[str, float]) -> None:
        """Write a row of the learning curve, and all metrics for TensorBoard, unless there was no
        trial since the last one.

        Raises:
            OutputError: The file cannot be written, or the disk is full.
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
        with writing(self._curve), self._curve.open("a", newline="") as file:
            csv.writer(file).writerows([row] if file.tell() else [COLUMNS, row])
        with writing(self._board.log_dir):
            for name, value in {"success_rate": self.success_rate, **metrics}.items():
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


def drop_rows_after(path: Path, episodes: int) -> None:
    """Remove rows that an interrupted training wrote after its last checkpoint, including an
    incomplete one, which may be the first.

    Raises:
        RunError: The file is not a learning curve.
    """
    if not path.exists():
        return
    try:
        rows = [row for row in path.read_text().splitlines(keepends=True) if row.endswith("\n")]
        kept = rows[:1] + [row for row in rows[1:] if int(row.split(",")[0]) <= episodes]
    except (OSError, ValueError) as error:
        raise RunError(f"'{path}' is not a learning curve: {error}") from None
    write_text(path, "".join(kept))
