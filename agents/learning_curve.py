"""The learning curve of a run: a CSV file that grows by a row every five hundred trials."""

import csv
from pathlib import Path

import numpy as np

from agents.errors import RunError

CURVE = "progress.csv"
COLUMNS = ("episodes", "seconds", "success_rate", "window", "entropy")


def append_row(path: Path, row: dict[str, float | int]) -> None:
    """Add a row, with the header where the file is new.

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
    """Take back what a killed training wrote after its last checkpoint, a half-written row too."""
    if not path.exists():
        return
    header, *rows = path.read_text().splitlines(keepends=True) or [""]
    kept = [row for row in rows if row.endswith("\n") and int(row.split(",")[0]) <= episodes]
    path.write_text("".join([header, *kept]))


def read_curve(path: Path) -> dict[str, np.ndarray]:
    """The columns by name.

    Raises:
        RunError: The file is missing, or no learning curve.
    """
    try:
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        return {name: np.array([float(row[name]) for row in rows]) for name in COLUMNS}
    except OSError as error:
        raise RunError(f"cannot read '{path}': {error.strerror or error}") from None
    except (KeyError, TypeError, ValueError) as error:
        raise RunError(f"'{path}' is no learning curve: {error!r}") from None
