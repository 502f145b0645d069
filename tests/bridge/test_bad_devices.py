"""What hangs on the other end may be slow, loud, half dead or just starting: no call waits for ever."""

import contextlib
import socket
import threading
import time

import numpy as np
import pytest

from hpac_gym.bridge import HandLink, HandshakeError, PortError, VirtualHand
from hpac_gym.bridge.frame import Frame, encode
from hpac_gym.bridge.hands import VirtualTransport
from hpac_gym.bridge.protocol import CONSTANTS
from hpac_gym.model import ServoCommand

BITS_PER_BYTE = 10


class RateLimitedTransport(VirtualTransport):
    """A UART: every byte takes ten bits of time, each way."""

    def __init__(self, hand, baud=CONSTANTS["baud"]):
        super().__init__(hand)
        self._hand = hand
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


def test_unacknowledged_moves_fill_the_line_to_within_a_tenth():
    hand = VirtualHand()
    with HandLink(lambda: RateLimitedTransport(hand)) as link:
        link.arm()
        command = ServoCommand(np.full(6, 0.05), 0.1)
        count, length = 2000, len(encode(Frame("move", 1, 0, {"session": 1 << 24, "duration_ms": 100, "servo": (500,) * 6})))
        before, start = link.status().counters["accepted"], hand.now_us
        for _ in range(count):
            link.move(command, acknowledge=False, pace=False)
        seconds = (hand.now_us - start) * 1e-6
        assert link.status().counters["accepted"] - before >= count
        assert count / seconds >= 0.9 * CONSTANTS["baud"] / BITS_PER_BYTE / length


def test_acknowledged_moves_keep_up_with_20_hz_at_9600_baud():
    hand = VirtualHand()
    with HandLink(lambda: RateLimitedTransport(hand, baud=9600), timeout=0.2) as link:
        link.arm()
        start = hand.now_us
        for i in range(20):
            link.move(ServoCommand(np.full(6, 0.01 * i), 0.05))
        assert (hand.now_us - start) * 1e-6 < 20 * 0.1
        assert link.statistics.retried == 0


def test_a_board_that_resets_when_the_port_opens_is_waited_for():
    hand = VirtualHand()

    class Resetting(VirtualTransport):
        def __init__(self, hand):
            super().__init__(hand)
            hand.restart()
            self._ready_us = hand.now_us + 1_500_000
            self._hand = hand

        def write(self, data):
            if self._hand.now_us > self._ready_us:
                super().write(data)

        def read(self, timeout):
            said = super().read(timeout)
            return said if self._hand.now_us > self._ready_us else b"ets Jul 29 2019 12:21:46\r\n"

    with HandLink(lambda: Resetting(hand)) as link:
        link.arm()
        assert link.state == "armed"
        assert link.statistics.bad_frames == 0 or link.statistics.retried > 10


class Server:
    """One TCP connection, served by a function in a thread."""

    def __init__(self, serve):
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._serve = serve
        self.stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        connection, _ = self._listener.accept()
        with connection:
            with contextlib.suppress(OSError):
                self._serve(connection, self.stop)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.stop.set()
        self._thread.join(5)
        self._listener.close()
        assert not self._thread.is_alive()


def flood(junk):
    def serve(connection, stop):
        while not stop.is_set():
            connection.sendall(junk)

    return serve


@pytest.mark.parametrize("junk", [b"x" * 4096, b"\0" * 4096, b"\5abc\0" * 800], ids=["text", "zeros", "broken frames"])
def test_a_flood_of_junk_ends_in_a_handshake_error(junk):
    with Server(flood(junk)) as server:
        start = time.monotonic()
        link = HandLink(server.port, handshake_timeout=0.4)
        with pytest.raises(HandshakeError, match="bytes received that are no answer"):
            link.connect()
        assert time.monotonic() - start < 30.0  # on a busy machine


class DribblingTransport(VirtualTransport):
    """Takes and gives single bytes, half a millisecond apart."""

    def __init__(self, hand):
        super().__init__(hand)
        self._hand, self._heard = hand, b""

    def write(self, data):
        for byte in data:
            super().write(bytes([byte]))
            self._heard += self._hand.run(5e-4)

    def read(self, timeout):
        self._heard += super().read(5e-4 if self._heard else timeout)
        said, self._heard = self._heard[:1], self._heard[1:]
        return said


def test_a_device_that_dribbles_single_bytes_still_works(virtual_hand):
    with HandLink(lambda: DribblingTransport(virtual_hand), timeout=3.0) as link:
        link.arm()
        link.move(ServoCommand(np.full(6, 0.2), 0.4))
        assert link.wait().state == "armed"
        np.testing.assert_allclose(link.status().servo, 0.2, atol=1e-4)


def test_a_connection_that_closes_is_a_port_error():
    with Server(lambda connection, stop: connection.recv(100)) as server:
        with pytest.raises(PortError, match="closed"):
            HandLink(server.port, handshake_timeout=0.4).connect()


def test_half_a_frame_before_the_cable_is_pulled_does_no_harm(virtual_hand, armed):
    virtual_hand.receive(encode(Frame("move", 50, 0, {"session": 1, "duration_ms": 500, "servo": (5000,) * 6}))[:13])
    armed.reconnect()
    armed.arm()
    armed.move(ServoCommand(np.full(6, 0.2), 0.4))
    np.testing.assert_allclose(armed.wait().servo, 0.2, atol=1e-4)
