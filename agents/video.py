"""Writers for rendered pictures: a video with a line of text in each picture, and a sheet of stills."""

from __future__ import annotations

from pathlib import Path

import imageio.v2 as imageio
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from agents.command import RunError
from hpac_gym.output import replacing

_TEXT_SIZE = 15


class Video:
    """Writes an MP4 file frame by frame; a context manager.

    Raises:
        RunError: The file cannot be written.
    """

    def __init__(self, path: Path, frames_per_second: int) -> None:
        self._fps = frames_per_second
        self._font = ImageFont.load_default(_TEXT_SIZE)
        try:
            self._writer = imageio.get_writer(path, fps=frames_per_second, macro_block_size=None, quality=7)
        except OSError as error:
            raise RunError(f"cannot write '{path}': {error.strerror or error}") from error

    def __enter__(self) -> Video:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def add(self, picture: np.ndarray, text: str) -> None:
        """Append a picture, shape (height, width, 3), with a line of text in its corner."""
        image = Image.fromarray(picture)
        ImageDraw.Draw(image).text((10, 8), text, fill=(40, 40, 40), font=self._font)
        self._writer.append_data(np.asarray(image))

    def hold(self, picture: np.ndarray, text: str, seconds: float = 0.5) -> None:
        """Append a picture that is shown for ``seconds`` [s]."""
        for _ in range(round(seconds * self._fps)):
            self.add(picture, text)


class Sheet:
    """A sheet of stills with one row per episode."""

    def __init__(self) -> None:
        self._rows: list[list[np.ndarray]] = []

    def begin_row(self) -> None:
        """Start a new episode."""
        self._rows.append([])

    def add(self, picture: np.ndarray) -> None:
        """Append a picture, shape (height, width, 3), to the row."""
        self._rows[-1].append(picture)

    def write(self, path: Path, width: int = 1200) -> None:
        """Write the sheet as an image of a given width [px]; short rows are padded with white.

        Raises:
            OutputError: The file cannot be written.
        """
        columns = max(len(row) for row in self._rows)
        blank = np.full_like(self._rows[0][0], 255)
        sheet = np.vstack([np.hstack([*row, *[blank] * (columns - len(row))]) for row in self._rows])
        image = Image.fromarray(sheet)
        with replacing(path) as temporary:
            image.resize((width, round(width * image.height / image.width)), Image.Resampling.LANCZOS).save(temporary)
