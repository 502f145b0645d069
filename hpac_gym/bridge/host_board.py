"""The firmware as a separate process behind a pseudo-terminal, in real time."""

from __future__ import annotations

import os
import select
import subprocess
import tempfile
from pathlib import Path
from shutil import rmtree

import numpy as np

from hpac_gym.bridge.errors import FirmwareMissing, PortError
from hpac_gym.bridge.transport import SerialTransport
from hpac_gym.model import SERVOS

_START_TIMEOUT = 5.0
_END_TIMEOUT = 1.0

BUILD_VARIABLE = "HPAC_FIRMWARE_BUILD"
"""Environment variable for another build folder, for programs that run outside a checkout."""


def firmware_file(name: str) -> Path:
    """Path of a file of the host build: `hpac_host`, `hpac_driver` or `libhpac.so`.

    Raises:
        FirmwareMissing: The file has not been built.
    """
    checkout = Path(__file__).parents[2] / "firmware" / "build"
    path = Path(os.environ.get(BUILD_VARIABLE, checkout)) / name
    if not path.exists():
        raise FirmwareMissing(f"{path} is missing: run `make firmware` in a checkout, or set {BUILD_VARIABLE}")
    return path


class HostBoard:
    """Starts the host firmware on entry and ends it on exit; it also ends by itself when this process ends.

    Args:
        arguments: additional command-line arguments of `hpac_host`, for example `("--boot-text",)`.

    Attributes:
        port: path of the pseudo-terminal.
        process: the running firmware.
    """

    def __init__(self, arguments: tuple[str, ...] = ()) -> None:
        self._arguments = arguments
        self._pulses = np.zeros(len(SERVOS), dtype=np.int64)
        self._read_to = 0

    def __enter__(self) -> HostBoard:
        program = firmware_file("hpac_host")
        self._owner = os.getpid()
        self._folder = Path(tempfile.mkdtemp(prefix="hpac_host_"))
        self._log = self._folder / "pulses.csv"
        self.process = subprocess.Popen(
            [program, "--pulses", self._log, "--parent", str(self._owner), *self._arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C must not end the board before the host has released it
        )
        ready, _, _ = select.select([self.process.stdout], [], [], _START_TIMEOUT)
        self.port = self.process.stdout.readline().strip() if ready else ""
        if not self.port:
            self.__exit__()
            raise PortError(f"{program} did not open a pseudo-terminal")
        return self

    def __exit__(self, *_: object) -> None:
        if self._owner != os.getpid():  # a forked child: the board belongs to its parent
            return
        self.process.terminate()
        try:
            self.process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:  # for example stopped in a debugger
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        rmtree(self._folder, ignore_errors=True)

    def connect(self) -> SerialTransport:
        """A serial transport to this board, for `HandLink(board.connect)`.

        Raises:
            PortError: The board has ended; its pseudo-terminal may belong to another program by now.
        """
        if self.process.poll() is not None:
            raise PortError(f"{self.port}: no such port; the board behind it has ended")
        return SerialTransport(self.port)

    def pulses(self) -> np.ndarray:
        """The present pulse widths, shape (6,) [ns]; 0 means no pulses.

        The firmware logs a change before it sends the answer that reports it: after `HandLink.wait` or
        `HandLink.status` this is at least as new as that answer.
        """
        changes = self.pulse_changes()
        if len(changes):
            self._pulses = changes[-1, 1:]
        return self._pulses.copy()

    def pulse_changes(self) -> np.ndarray:
        """All changes of the pulse widths since the last call, shape (n, 7): time [µs], then six widths [ns]."""
        with self._log.open("rb") as log:
            log.seek(self._read_to)
            lines, newline, _ = log.read().rpartition(b"\n")
        self._read_to += len(lines) + len(newline)
        rows = [[int(value) for value in line.split(b",")] for line in lines.splitlines()]
        return np.array(rows, dtype=np.int64).reshape(-1, 1 + len(SERVOS))
