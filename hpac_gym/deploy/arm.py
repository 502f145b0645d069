"""The arm that carries the hand: it is told what to do, and tells when it is ready.

A task's wrist stands, lifts and shakes by a table. On a hand a person, or another program, does it."""

import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from hpac_gym.deploy.errors import MALFORMED, VERSION, DeployError, packet, udp
from hpac_gym.progress import Late

PACKET = "hpac_arm"
"""Name of the version field of both packets, one a datagram: told in every step is ``{"hpac_arm": 1,
"phase": "lift", "time": 1.2, "offset": [x, y, z]}``, with the time since the hand began to close [s]
and the wrist's offset from its start along the world's axes [m]; answered to those of the phase
``ready``, which come until then, is ``{"hpac_arm": 1, "ready": true}``. These also tell the `wrist`
of a policy that places it, −1…1 by the name of the action.
"""


class Arm:
    """Carries the hand. As it stands nobody does, or a table by its own clock: ready at once."""

    def ready(self, wait: Callable[[float], None], told: dict[str, Any]) -> None:
        """Return when the hand is where it shall close; `wait` keeps it alive for some seconds."""

    def tell(self, told: dict[str, Any]) -> None:
        """Take note of the phase and of the wrist's offset, in every step; never waits."""

    def close(self) -> None:
        """Let go what the arm holds."""


class Person(Arm):
    """A person with the Enter key, to whom every phase is told."""

    _phase = ""

    def ready(self, wait: Callable[[float], None], told: dict[str, Any]) -> None:
        """Wait for Enter; one that was typed before the question is none."""
        import select
        import termios

        if sys.stdin.isatty():
            termios.tcflush(sys.stdin, termios.TCIFLUSH)
        for name, value in told.get("wrist", {}).items():
            print(f"arm: the policy places {name} {value:+.2f}", file=sys.stderr)
        print(
            "the object is seen; Enter: the hand stands there, close", file=sys.stderr, flush=True
        )
        key = b""
        while key not in (b"\n", b"\r"):
            while not select.select([sys.stdin], [], [], 0)[0]:
                wait(0.05)
            if not (key := os.read(sys.stdin.fileno(), 1)):
                raise DeployError("nobody can press Enter: standard input is closed")

    def tell(self, told: dict[str, Any]) -> None:
        """Print a phase that begins."""
        if told["phase"] != self._phase:
            self._phase = told["phase"]
            with suppress(OSError):
                print(f"\narm: {self._phase}", file=sys.stderr, flush=True)


class Remote(Arm):
    """A program that moves an arm, told by UDP; see `PACKET`.

    Raises:
        DeployError: The address is none.
    """

    def __init__(self, host: str, port: int) -> None:
        self._where = f"the arm at {host}:{port}"
        self._socket = udp(self._where, host, port)

    def ready(self, wait: Callable[[float], None], told: dict[str, Any]) -> None:
        """Ask until the arm answers that it is ready; an answer that came before is none.

        Raises:
            DeployError: It does not within a minute.
        """
        with suppress(OSError):  # until none is left
            while True:
                self._socket.recv(4096)
        late = Late(f"waiting for {self._where}")
        for _ in range(600):
            self.tell(told)
            wait(0.1)
            late()
            with suppress(OSError, *MALFORMED):
                if packet(self._socket.recv(4096), PACKET)["ready"] is True:
                    return
        raise DeployError(f"{self._where} did not say that it is ready within 60 s")

    def tell(self, told: dict[str, Any]) -> None:
        """Send a packet; that nobody listens is noticed by `ready` alone."""
        with suppress(OSError):
            self._socket.send(json.dumps({PACKET: VERSION, **told}).encode())

    def close(self) -> None:
        self._socket.close()


def arm_of(text: str) -> Arm:
    """The arm of an ``--arm``: ``none``, ``enter``, or ``udp:HOST:PORT``.

    Raises:
        DeployError: It is none of them, or nobody can press Enter.
    """
    if text == "enter" and sys.stdin is None:
        raise DeployError("--arm enter, and standard input is closed")
    if text in ("none", "enter"):
        return Person() if text == "enter" else Arm()
    kind, _, address = text.partition(":")
    host, _, port = address.rpartition(":")
    if kind != "udp" or not host or not port.isdecimal():
        raise DeployError(f"--arm '{text}' is not none, enter or udp:HOST:PORT")
    return Remote(host, int(port))
