"""What is wrong with a wire: frames that are lost, damaged or late; in virtual time and in real time."""

import os
import pty
import select
import tty
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from hpac_gym.bridge import HostBoard, VirtualHand
from hpac_gym.bridge.hands import VirtualTransport
from hpac_gym.settings import check_bounds, setting


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults of a wire. A damaged frame has one bit flipped; each delay of the host's is drawn anew.

    Raises:
        ParameterError: A share that is not in [0, 1], or a delay that is not in [0, 10] s.
    """

    loss: float = setting(
        0.0, "share of the frames that are lost, in each direction", bounds=(0.0, 1.0)
    )
    damage: float = setting(0.0, "share of the frames that are damaged", bounds=(0.0, 1.0))
    jitter: float = setting(0.0, "the host's frames are late by up to this [s]", bounds=(0.0, 10.0))
    latency: float = setting(
        0.0,
        "the hand's frames are late by this [s], 0.016 for many USB adapters",
        bounds=(0.0, 10.0),
    )

    def __post_init__(self) -> None:
        check_bounds(self)


class Way:
    """One direction of a wire: what is sent comes out in order, late, damaged or not at all.

    Args:
        rng: draws what happens to a frame.
        faults: of the wire.
        to_hand: the direction from the host to the hand; False is back.
    """

    def __init__(self, rng: np.random.Generator, faults: Faults, to_hand: bool) -> None:
        self.faults = faults
        self._rng = rng
        self._to_hand = to_hand
        self._under_way: list[tuple[float, bytes]] = []
        self._begun = b""

    def send(self, now: float, data: bytes) -> None:
        """Bytes go in; whole frames are lost or damaged."""
        *frames, self._begun = (self._begun + data).split(b"\0")
        for frame in filter(None, frames):
            if self._rng.random() < self.faults.loss:
                continue
            if self._rng.random() < self.faults.damage:
                place = int(self._rng.integers(len(frame)))
                flipped = frame[place] ^ 1 << int(self._rng.integers(8))
                frame = frame[:place] + bytes([flipped]) + frame[place + 1 :]
            late = (
                self._rng.uniform(0, self.faults.jitter) if self._to_hand else self.faults.latency
            )
            due = max(now + late, self._under_way[-1][0] if self._under_way else 0.0)
            self._under_way.append((due, b"\0" + frame + b"\0"))

    @property
    def due(self) -> float:
        """When the next frame comes out [s]."""
        return self._under_way[0][0] if self._under_way else np.inf

    def arrived(self, now: float) -> bytes:
        """What has come out by now."""
        count = sum(due <= now for due, _ in self._under_way)
        data = b"".join(frame for _, frame in self._under_way[:count])
        del self._under_way[:count]
        return data


class BadTransport(VirtualTransport):
    """A wire with faults to a hand in virtual time.

    Attributes:
        there, back: its two ways, whose faults may change.
    """

    def __init__(self, hand: VirtualHand, rng: np.random.Generator, faults: Faults) -> None:
        super().__init__(hand)
        self.there = Way(rng, faults, to_hand=True)
        self.back = Way(rng, faults, to_hand=False)

    def write(self, data: bytes) -> None:
        self.there.send(self.now(), data)

    def read(self, timeout: float) -> bytes:
        until = self.now() + timeout
        while True:
            now = self.now()
            if data := self.there.arrived(now):
                super().write(data)
            if (data := self.back.arrived(now)) or now >= until:
                return data
            due = min(until, self.there.due, self.back.due)
            data = super().read(max(due - now, 1e-6))
            self.back.send(self.now(), data)


class Relay:
    """A pseudo-terminal in front of a board, with a wire of faults between them.

    Args:
        board: the running board.
        faults: of the wire.
        seed: of the faults.
        resets: the board restarts whenever a program opens the port, as many USB adapters make it.

    Attributes:
        port: path of the pseudo-terminal.
    """

    def __init__(self, board: HostBoard, faults: Faults, seed: int, resets: bool) -> None:
        self._board = board
        rng = np.random.default_rng([seed, 8])
        self._there = Way(rng, faults, to_hand=True)
        self._back = Way(rng, faults, to_hand=False)
        self._front, far_end = pty.openpty()
        tty.setraw(far_end)
        os.set_blocking(self._front, False)
        self.port = os.ttyname(far_end)
        self._ends = [self._front, far_end]
        self._open = not resets
        self._connect()
        if resets:  # that nobody has the port open shows only if this program has not either
            os.close(self._ends.pop())

    def _connect(self) -> None:
        self._core = os.open(self._board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def descriptors(self) -> list[int]:
        """What a program waits for before it calls `turn`."""
        return [self._core, self._front] if self._open else [self._core]

    def due(self) -> float:
        """When the next frame comes out [s]."""
        return min(self._there.due, self._back.due)

    def turn(self, now: float) -> None:
        """Pass on what has come, at a time [s]; never waits."""
        self._watch()
        with suppress(OSError):  # nothing there, or nobody
            self._there.send(now, os.read(self._front, 4096))
        with suppress(OSError):
            self._back.send(now, os.read(self._core, 4096))
        for way, to in ((self._there, self._core), (self._back, self._front)):
            if data := way.arrived(now):
                with suppress(OSError):  # a reader that is full, or gone, loses it
                    os.write(to, data)

    def _watch(self) -> None:
        """Restart the board when a program opens the port, which is open all the time otherwise."""
        poll = select.poll()
        poll.register(self._front, select.POLLIN)
        was = self._open
        self._open = not any(event & select.POLLHUP for _, event in poll.poll(0))
        if self._open and not was:
            os.close(self._core)
            self._board.__exit__()
            self._board.__enter__()
            self._connect()

    def close(self) -> None:
        """Close both ends."""
        for end in (*self._ends, self._core):
            os.close(end)
