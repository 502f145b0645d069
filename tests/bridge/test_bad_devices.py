"""What hangs on the other end may be slow, loud, half dead or just starting: no call waits for
ever.
"""

import contextlib
import socket
import threading
import time

import numpy as np
import pytest

from hpac_gym.bridge import HandLink, HandshakeError, VirtualHand
from hpac_gym.bridge.frame import Frame, encode
from hpac_gym.bridge.hands import VirtualTransport
from hpac_gym.model import ServoCommand

BITS_PER_BYTE = 10


class RateLimitedTransport(VirtualTransport):
    """A UART: every byte takes ten bits of time, each way."""

    def __init__(self, hand, baud):
        super().__init__(hand)
        self._baud = baud
        self._heard = b""

    def _pass(self, count):
        until_us = self._hand.now_us + count * BITS_PER_BYTE * 1e6 / self._baud
        while self._hand.now_us < until_us:
            self._heard += self._hand.run((until_us - self._hand.now_us) * 1e-6)

    def write(self, data):
        self._pass(len(data))
        super().write(data)

    def read(self, timeout):
        said = self._heard + super().read(0 if self._heard else timeout)
        self._heard = b""
        self._pass(len(said))
        return said


def test_acknowledged_moves_keep_up_with_20_hz_at_9600_baud():
    hand = VirtualHand()
    with HandLink(lambda: RateLimitedTransport(hand, baud=9600), timeout=0.2) as link:
        link.arm()
        start = hand.now_us
        for i in range(20):
            link.move(ServoCommand(np.full(6, 0.01 * i), 0.05))
        assert (hand.now_us - start) * 1e-6 < 20 * 0.1
        assert link.statistics.retried == 0


@contextlib.contextmanager
def flooded(junk):
    """A port at which junk arrives without end."""
    stop = threading.Event()

    def serve():
        connection, _ = listener.accept()
        with connection, contextlib.suppress(OSError):
            while not stop.is_set():
                connection.sendall(junk)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}"
        stop.set()
        thread.join(5)
    assert not thread.is_alive()


@pytest.mark.parametrize(
    "junk", [b"x" * 4096, b"\0" * 4096, b"\5abc\0" * 800], ids=["text", "zeros", "broken frames"]
)
def test_a_flood_of_junk_ends_in_a_handshake_error(junk):
    with flooded(junk) as port:
        start = time.monotonic()
        with pytest.raises(HandshakeError, match="bytes received that are no answer"):
            HandLink(port, handshake_timeout=0.2).connect()
        assert time.monotonic() - start < 30.0  # on a busy machine


class DribblingTransport(VirtualTransport):
    """Takes and gives single bytes, half a millisecond apart."""

    def __init__(self, hand):
        super().__init__(hand)
        self._heard = b""

    def write(self, data):
        for byte in data:
            super().write(bytes([byte]))
            self._heard += self._hand.run(5e-4)

    def read(self, timeout):
        self._heard += super().read(5e-4 if self._heard else timeout)
        said = self._heard[:1]
        self._heard = self._heard[1:]
        return said


def test_a_device_that_dribbles_single_bytes_still_works(virtual_hand):
    with HandLink(lambda: DribblingTransport(virtual_hand), timeout=3.0) as link:
        link.arm()
        link.move(ServoCommand(np.full(6, 0.2), 0.4))
        assert link.wait().state == "armed"
        np.testing.assert_allclose(link.status().servo, 0.2, atol=1e-4)


def test_half_a_frame_before_the_cable_is_pulled_does_no_harm(virtual_hand, armed):
    virtual_hand.receive(
        encode(Frame("move", 50, 0, {"session": 1, "duration_ms": 500, "servo": (5000,) * 6}))[:13]
    )
    armed.connect()
    armed.arm()
    armed.move(ServoCommand(np.full(6, 0.2), 0.4))
    np.testing.assert_allclose(armed.wait().servo, 0.2, atol=1e-4)
