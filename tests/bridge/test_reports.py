"""What the hand says about itself: every field in its unit, and what may be concluded from an
answer.
"""

import fcntl
import json
import math
import os
import pty
import socket
import struct
import termios
from types import SimpleNamespace

import numpy as np
import pytest

from hpac_gym.bridge import HandLink, LinkStatistics, PortError, VirtualHand, WireLog
from hpac_gym.bridge.commands import _print_json
from hpac_gym.bridge.doctor import Finding
from hpac_gym.bridge.limits import ServoLimits
from hpac_gym.bridge.protocol import Fault, Field, Frame, Message, Reason, State, decode
from hpac_gym.bridge.reports import HandInfo, HandStatus, KnownState
from hpac_gym.bridge.transport import _open_advice, open_transport
from hpac_gym.model import SERVOS
from tools.wire_files import vectors

EXAMPLES = {name: decode(wire[1:-1]) for name, verdict, wire in vectors() if verdict == "ok"}


def test_every_field_of_a_status_is_read_in_its_unit():
    status = HandStatus.from_frame(EXAMPLES["device_status"])
    assert status.uptime == pytest.approx(0x01020304 * 1e-3)
    assert (status.state, status.fault, status.attached, status.moving) == (
        "armed",
        "watchdog",
        SERVOS,
        True,
    )
    np.testing.assert_allclose(status.servo, [0, 1e-4, 0.0255, 0.0256, 0.8191, 1.3])
    np.testing.assert_allclose(status.heat, [0, 0.01, 0.02, 0.99, 1.0, 2.55])
    assert (status.rate_share, status.supply, status.last_seq) == (1.0, 5.0, 0xABCD)
    assert list(status.counters.values()) == [70000, 1, 2, 3, 4, 5, 6, 65535]


def test_the_angles_of_a_status_that_a_stream_goes_on_from_cannot_be_changed():
    status = HandStatus.from_frame(EXAMPLES["device_status"])
    for array in (status.servo, status.heat):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_what_a_board_does_not_measure_is_not_a_number():
    fields = EXAMPLES["device_status"].fields | {"supply_mv": 0, "attached": 0b000101, "moving": 0}
    status = HandStatus.from_frame(Frame("device_status", 1, 0, fields))
    assert math.isnan(status.supply)
    assert (status.attached, status.moving) == ((SERVOS[0], SERVOS[2]), False)


def test_every_field_of_a_hello_is_read_in_its_unit():
    info = HandInfo.from_frame(EXAMPLES["device_hello"])
    assert (info.firmware_version, info.watchdog, info.reset, info.boot_count, info.state) == (
        "0.2.0",
        0.25,
        "power_on",
        258,
        "armed",
    )
    assert (info.session, info.trim_ns, info.reversed_mask) == (
        0x12345678,
        (0, -1, 1, -20000, 20000, 256),
        0b100010,
    )


def status_frame(state, attached):
    return Frame(
        "device_status",
        1,
        0,
        EXAMPLES["device_status"].fields | {"state": state, "attached": attached},
    )


def ack(state, reason=Reason.ok, servo=255):
    return Frame("ack", 1, 0, {"acked": 3, "reason": reason, "servo": servo, "state": state})


@pytest.mark.parametrize(
    ("frame", "answered", "may_have_power"),
    [
        (status_frame(State.idle, 0), "status", False),
        (status_frame(State.idle, 1), "status", True),
        (status_frame(State.armed, 0), "status", True),
        (status_frame(State.fault, 0), "status", False),
        (status_frame(State.fault, 32), "status", True),
        (status_frame(State.idle, 0), None, True),
        (ack(State.idle), "clear", False),
        (ack(State.boot), "clear", False),
        (ack(State.fault, Reason.estop), "clear", True),
        (ack(State.fault), "estop", False),
        (ack(State.fault, Reason.version), "estop", True),
        (ack(State.idle), "estop", True),
        (ack(State.idle), "move", True),
        (ack(State.idle), "arm", True),
        (
            Frame("device_hello", 1, 0, EXAMPLES["device_hello"].fields | {"state": State.idle}),
            "hello",
            False,
        ),
        (
            Frame("device_hello", 1, 0, EXAMPLES["device_hello"].fields | {"state": State.fault}),
            "hello",
            True,
        ),
    ],
)
def test_only_an_answer_that_says_so_means_no_power(frame, answered, may_have_power):
    known = KnownState()
    assert known.may_have_power
    known.take_in(frame, answered)
    assert known.may_have_power is may_have_power


def test_a_fault_is_known_until_the_hand_says_otherwise():
    known = KnownState()
    known.take_in(Frame("fault", 0, 0, {"fault": Fault.overload, "servo": 1, "uptime_ms": 5}))
    assert (known.state, known.fault, known.in_fault) == ("fault", "overload", True)
    known.take_in(ack(State.fault, Reason.state))
    assert known.fault == "overload"
    known.take_in(ack(State.armed))
    assert (known.fault, known.in_fault, known.state) == ("none", False, "armed")
    known.forget()
    assert (known.state, known.fault, known.may_have_power) == ("boot", "none", True)


@pytest.mark.parametrize(
    ("frame", "words", "reason", "servo"),
    [
        (
            ack(State.armed, Reason.rate, 5),
            "the hand refused move: rate at servo thumb_cmc (state armed)",
            "rate",
            "thumb_cmc",
        ),
        (
            ack(State.armed, Reason.rate, 6),
            "the hand refused move: rate (state armed)",
            "rate",
            None,
        ),
        (
            ack(State.armed, Reason.session),
            "another program has greeted the hand since",
            "session",
            None,
        ),
        (
            ack(State.fault, Reason.hot, 0),
            "the hand is in fault (none): move refused; `hpac clear` or HandLink.clear() leaves it",
            "hot",
            "thumb_mp",
        ),
        (
            ack(State.armed, 99),
            "the hand refused move: unknown_99 (state armed)",
            "unknown_99",
            None,
        ),
    ],
)
def test_a_refusal_says_what_and_where(frame, words, reason, servo):
    known = KnownState()
    known.take_in(frame, "move")
    error = known.refusal(Frame("move"), frame)
    assert words in str(error)
    assert (error.reason, error.servo, error.state) == (reason, servo, known.state)


def test_an_arm_that_is_refused_as_hot_without_a_servo_is_a_refusal():
    known = KnownState()
    known.take_in(status_frame(State.idle, 0))
    error = known.refusal(Frame("arm"), ack(State.idle, Reason.hot))
    assert str(error) == "the hand refused arm: hot (state idle)"


def test_round_trips_are_kept_within_bounds():
    statistics = LinkStatistics()
    assert math.isnan(statistics.round_trip(50))
    statistics.round_trips.extend(range(100_001))
    assert len(statistics.round_trips) == 100_000
    assert statistics.round_trip(0) == 1
    assert statistics.round_trip(50) == pytest.approx(50_000.5)


# --- a socket
# ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def pair():
    with socket.create_server(("127.0.0.1", 0)) as server:
        transport = open_transport(f"socket://127.0.0.1:{server.getsockname()[1]}")
        with server.accept()[0] as other_end:
            yield transport, other_end
        transport.close()


def test_a_socket_carries_bytes_both_ways_and_waits_no_longer_than_told(pair):
    transport, other_end = pair
    transport.write(b"to the hand")
    assert other_end.recv(100) == b"to the hand"
    start = transport.now()
    assert transport.read(0.0) == b""
    assert transport.read(0.02) == b""
    assert 0.015 < transport.now() - start < 1.0
    other_end.sendall(b"back")
    assert transport.read(1.0) == b"back"
    quiet = transport._serial._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    assert quiet, "a stop must not wait until the move before it is acknowledged"


def test_what_a_socket_has_sent_before_it_goes_is_read_and_then_it_is_a_port_error(pair):
    transport, other_end = pair
    other_end.sendall(b"the last answer")
    other_end.close()
    assert transport.read(1.0) == b"the last answer"
    with pytest.raises(PortError, match="socket disconnected"):
        transport.read(1.0)
    transport.close()
    with pytest.raises(PortError, match="has gone"):
        transport.read(0.1)
    with pytest.raises(PortError, match="takes no bytes"):
        transport.write(b"x")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("/dev/does_not_exist", ": no such port"),
        ("/dev/no_clock", ": no such port"),
        ("/dev/null", " is not a serial port"),
        (__file__, " is not a serial port"),
        ("/dev", " is not a serial port"),
        ("socket://localhost:1", " cannot be opened: Connection refused"),
        ("socket://:1", " cannot be opened: Connection refused"),
        *(
            (f"socket://{rest}", " cannot be opened: it is not socket://HOST:PORT, at most 65535")
            for rest in ("", "host", "host:", "host:x", "host:70000")
        ),
    ],
)
def test_a_wrong_port_is_named_and_says_what_is_wrong(name, says):
    with pytest.raises(PortError, match=name + says):
        open_transport(name)


@pytest.mark.parametrize(
    ("error", "advice"),
    [
        (OSError("Could not exclusively lock port X"), "is used by another program"),
        (OSError("[Errno 13] Permission denied"), "dialout"),
        (OSError("No such file or directory: X"), "no such port"),
        (FileNotFoundError("gone"), "no such port"),
        (OSError("could not open port 'COM9': FileNotFoundError(2, '')"), "no such port"),
        (OSError("Could not configure port: (5, 'Input/output error')"), "opened: unplugged?"),
        (OSError("something else"), "cannot be opened: something else"),
    ],
)
def test_a_port_that_does_not_open_says_what_to_do(error, advice):
    assert advice in _open_advice("X", error)


def test_a_port_gives_all_that_lies_there_and_says_when_it_was_unplugged():
    ours, theirs = pty.openpty()
    transport = open_transport(os.ttyname(theirs))
    os.write(ours, b"abc")
    assert transport.read(5.0) == b"abc"
    os.close(theirs)
    os.close(ours)
    with pytest.raises(PortError, match=r"has gone: unplugged\?$"):
        transport.read(0.1)
    with pytest.raises(PortError, match=r"takes no bytes: unplugged\?$"):
        transport.write(b"x")


def test_no_line_of_a_port_is_low_alone_which_would_reset_many_boards(monkeypatch):
    """Linux raises both as it opens a port; a pseudo-terminal has none."""
    both = termios.TIOCM_DTR | termios.TIOCM_RTS
    lines = [both]
    real = fcntl.ioctl

    def ioctl(fd, request, value=0, *rest):
        if request not in (termios.TIOCMBIS, termios.TIOCMBIC):
            return real(fd, request, value, *rest)
        (chosen,) = struct.unpack("I", value)
        raised = request == termios.TIOCMBIS
        lines.append(lines[-1] | chosen if raised else lines[-1] & ~chosen)
        return 0

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    ours, theirs = pty.openpty()
    open_transport(os.ttyname(theirs)).close()
    os.close(theirs)
    os.close(ours)
    assert set(lines) == {both, 0}
    assert lines[-1] == 0


# --- values
# -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind",
    [Frame, HandInfo, HandStatus, Finding, Field, Message, ServoLimits],
    ids=lambda k: k.__name__,
)
def test_what_has_been_read_cannot_be_changed(kind):
    assert kind.__dataclass_params__.frozen
    assert hasattr(kind, "__slots__")


@pytest.mark.parametrize(
    ("drawn", "session"), [(lambda below: 0, 1), (lambda below: below - 1, 0xFFFFFFFF)]
)
def test_a_session_is_any_number_of_32_bits_but_zero(monkeypatch, drawn, session):
    monkeypatch.setattr("hpac_gym.bridge.exchange.secrets.randbelow", drawn)
    with HandLink(VirtualHand().connect) as link:
        assert link.info.session == session


def test_a_log_line_has_microseconds_and_a_tenth_of_them_for_a_round_trip(tmp_path):
    with WireLog(tmp_path / "log") as log:
        log.record(1 / 3, "sent", b"\x01", Frame("estop", 7), 2 / 3)
    line = json.loads((tmp_path / "log").read_text())
    assert (line["t"], line["round_trip"], line["hex"], line["seq"]) == (
        0.333333,
        0.6666667,
        "01",
        7,
    )


def test_json_is_indented_and_in_plain_letters(capsys):
    _print_json([SimpleNamespace(claim="host silent → detach")], "claim")
    assert capsys.readouterr().out == '[\n  {\n    "claim": "host silent → detach"\n  }\n]\n'
