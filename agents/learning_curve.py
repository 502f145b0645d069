"""The learning curve of a run: a CSV file that gets a row every five hundred trials."""

import csv
from pathlib import Path

import numpy as np

from agents.errors import RunError

CURVE = "progress.csv"
COLUMNS = ("episodes", "seconds", "success_rate", "window", "entropy")


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
