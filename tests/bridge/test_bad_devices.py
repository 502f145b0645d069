"""What hangs on the other end may be slow, loud, half dead or just starting: no call waits for
ever.
"""

import contextlib
import socket
import threading
import time

import numpy as np
import pytest

from hpac_gym.bridge import HandLink, HandshakeError
from hpac_gym.bridge.frame import Frame, encode
from hpac_gym.model import ServoCommand


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
        with pytest.raises(HandshakeError, match="no hand answers: "):
            HandLink(port, handshake_timeout=0.2).connect()
        assert time.monotonic() - start < 30.0  # on a busy machine


def test_a_device_that_dribbles_single_bytes_still_works(armed):
    said = bytearray()
    read = armed.exchange.transport.read

    def dribble(timeout):
        said.extend(b"" if said else read(timeout))
        return bytes([said.pop(0)] if said else [])

    armed.exchange.transport.read = dribble
    armed.move(ServoCommand(np.full(6, 0.2), 0.4))
    assert armed.wait().state == "armed"
    np.testing.assert_allclose(armed.status().servo, 0.2, atol=1e-4)


def test_half_a_frame_before_the_cable_is_pulled_does_no_harm(virtual_hand, armed):
    virtual_hand.receive(
        encode(Frame("move", 50, 0, {"session": 1, "duration_ms": 500, "servo": (5000,) * 6}))[:13]
    )
    armed.connect()
    armed.arm()
    armed.move(ServoCommand(np.full(6, 0.2), 0.4))
    np.testing.assert_allclose(armed.wait().servo, 0.2, atol=1e-4)
