"""How often and when a link speaks: repeats, heartbeats, last words, counters; and that no call waits
for ever, whatever hangs on the other end.
"""

import dataclasses
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from unittest.mock import Mock

import numpy as np
import pytest

from hpac_gym.bridge import (
    Action,
    FaultError,
    HandLink,
    HandshakeError,
    LinkTimeout,
    PortError,
    RejectedError,
    StoppedError,
    UnconfirmedWarning,
    connection,
)
from hpac_gym.bridge.connection import Turns
from hpac_gym.bridge.doctor import _judge, diagnose, greet
from hpac_gym.bridge.exchange import Exchange, LinkStatistics
from hpac_gym.bridge.hands import VirtualTransport
from hpac_gym.bridge.protocol import FLAG_MINIMUM_JERK, MESSAGES, Frame, decode, encode
from hpac_gym.model import HPAC, ServoCommand
from tests.bridge.devices import LOST, Device


def gaps(said):
    return np.diff([time for time, _ in said])


@pytest.fixture
def deaf(overheard):
    """A wire on which the hand hears nothing."""
    overheard.there.faults = LOST
    return overheard


def test_a_handshake_is_tried_every_tenth_of_a_second_for_three(deaf):
    with pytest.raises(HandshakeError, match="no hand answers: silence for 3 s; is the") as caught:
        HandLink(lambda: deaf).connect()
    hellos = deaf.of("hello")
    assert len(hellos) == 30 + 3
    np.testing.assert_allclose(gaps(hellos[:30]), 0.1, atol=0.002)
    assert len({frame.fields["nonce"] for _, frame in hellos}) == 1
    assert hellos[0][1].fields["nonce"] != 0
    assert len(deaf.of("clear")) == 3
    assert "(sent HELLO × 3, CLEAR × 3: no answer)" in caught.value.__notes__[0]


def test_a_frame_is_sent_three_times_a_tenth_of_a_second_apart(link, overheard):
    link.arm()
    overheard.there.faults = LOST
    before = len(overheard.of("status"))
    with pytest.raises(LinkTimeout, match=r"no answer to heartbeat: 3 times, 0.1 s each"):
        link.heartbeat()
    said = overheard.of("heartbeat")[-3:]
    np.testing.assert_allclose(gaps(said), 0.1, atol=0.002)
    assert len({frame.seq for _, frame in said}) == 1
    assert len(overheard.of("status")) == before + 3
    assert link.statistics.retried == 4
    before = len(overheard.frames)
    begun = overheard.now()
    with pytest.warns(UnconfirmedWarning, match=r"sent CLEAR × \d+, ESTOP × \d+") as told:
        link.close()
    assert 3.0 <= overheard.now() - begun < 4.5
    assert "switch their supply off" in str(told[0].message)
    names = [frame.name for _, frame in overheard.frames[before:]]
    words = [name for name in names if name != "status"]
    assert words[:10] == (["clear"] * 3 + ["estop"] * 2) * 2


class Robbed(VirtualTransport):
    """Some of the hand's answers are read by another program."""

    stolen = 0

    def read(self, timeout):
        data = super().read(timeout)
        if data and self.stolen:
            self.stolen -= 1
            return b""
        return data


def test_a_stop_whose_sender_reads_the_answers_is_told_as_a_stop(virtual_hand):
    """Two programs read one port: `hpac estop` may get all the answers for a while."""
    robbed = Robbed(virtual_hand)
    with HandLink(lambda: robbed) as link:
        link.arm()
        robbed.stolen = 4  # that of the stop, and of the heartbeat sent three times
        robbed.write(encode(Frame("estop", 7, 0, {})))
        with pytest.raises(FaultError, match=r"in fault \(estop\): heartbeat was not answered"):
            link.heartbeat()


def test_a_stop_that_only_a_later_status_confirms_is_confirmed(virtual_hand):
    robbed = Robbed(virtual_hand)
    with HandLink(lambda: robbed) as link:
        link.arm()
        robbed.stolen = 3
        link.estop()
        assert not virtual_hand.pulses().any()


def test_no_call_of_another_thread_comes_between_the_last_words_and_the_end(virtual_hand):
    said = []

    def arm():
        try:
            link.arm()
        except PortError as error:
            said.append(f"{error}")

    class Slow(VirtualTransport):
        def close(self):
            other = threading.Thread(target=arm)
            other.start()
            other.join()
            super().close()

    link = HandLink(lambda: Slow(virtual_hand))
    link.connect()
    link.close()
    assert said == ["not connected"]
    assert not virtual_hand.pulses().any()


@pytest.mark.parametrize("stolen", [0, 1, 2, 3])
def test_a_stopped_program_leaves_the_fault_even_if_the_stops_sender_reads_its_answers(
    virtual_hand, stolen
):
    robbed = Robbed(virtual_hand)
    with pytest.raises(FaultError, match="estop"), HandLink(lambda: robbed) as link:  # noqa: PT012
        link.arm()
        robbed.write(encode(Frame("estop", 7, 0, {})))
        try:
            link.sleep(1.0)
        finally:
            robbed.stolen = stolen
    with HandLink(virtual_hand.connect) as link:
        assert link.status().fault == "estop"


def test_the_last_words_to_a_stopped_hand_that_is_silent_leave_the_fault_latched():
    exchange = Mock(**{"request.side_effect": LinkTimeout("no answer")})
    exchange.transport.now.side_effect = range(100)
    exchange.known = Mock(in_fault=True, may_have_power=True, fault="estop")
    connection.last_words(exchange, True, 0.1)
    assert {call.args[0] for call in exchange.request.call_args_list} == {"status", "estop"}


def test_an_ack_of_another_message_is_no_answer(virtual_hand):
    def confused(data):
        fields = {"acked": MESSAGES["move"].code, "reason": 0, "servo": 255, "state": 2}
        return encode(Frame("ack", decode(data[1:-1]).seq, 0, fields))

    exchange = Exchange(Device(virtual_hand, confused), LinkStatistics())
    with pytest.raises(LinkTimeout, match="no answer to heartbeat"):
        exchange.request("heartbeat")


@pytest.mark.parametrize(("watchdog", "latency"), [(0.1, 0), (0.4, 0), (2.0, 0), (0.4, 0.06)])
def test_four_signs_of_life_come_within_a_watchdogs_period(link, overheard, watchdog, latency):
    """A slow answer does not make the next one late: the hand counts from what it heard."""
    link.arm(watchdog=watchdog)
    overheard.spoil(latency=latency)
    link.sleep(10 * watchdog)
    said = overheard.of("heartbeat")[-30:]
    np.testing.assert_allclose(gaps(said), watchdog / 4, atol=0.002)
    assert link.sleep(0.0) is None
    assert link.sleep(-1.0) is None


def test_what_is_not_said_has_the_documented_values(link, overheard):
    link.arm()
    ((_, arm),) = overheard.of("arm")
    assert (arm.fields["watchdog_ms"], arm.fields["action"], arm.flags) == (400, Action.relax, 0)
    link.move(ServoCommand(np.full(6, 0.01), 0.05))
    link.move(ServoCommand(np.full(6, 0.02), 0.050001), minimum_jerk=True, pace=False)
    first, second = (frame for _, frame in overheard.of("move"))
    assert (first.fields["duration_ms"], first.flags) == (50, 0)
    assert (second.fields["duration_ms"], second.flags) == (51, FLAG_MINIMUM_JERK)
    assert first.fields["servo"] == (100,) * 6
    link.status()
    link.status(period=0.05)
    assert [frame.fields["period_ms"] for _, frame in overheard.of("status")[-2:]] == [0, 50]


def test_a_move_waits_for_the_one_before_and_no_longer(link, overheard):
    link.arm()
    for i in range(5):
        link.move(ServoCommand(np.full(6, 0.01 * i), 0.05))
    np.testing.assert_allclose(gaps(overheard.of("move")), 0.05, atol=0.002)
    for i in range(5):
        link.move(ServoCommand(np.full(6, 0.01 * i), 0.05), pace=False)
    assert max(gaps(overheard.of("move")[-5:])) < 0.01


def test_arming_again_in_a_long_move_waits_for_its_end(link):
    link.arm()
    link.move(ServoCommand(np.full(6, 0.1), 10.0))
    link.arm(watchdog=1.0)
    np.testing.assert_allclose(link.last_status.servo, 0.1)


def test_arming_asks_every_twentieth_of_a_second(link, overheard):
    link.arm()
    asked = overheard.of("status")
    assert 40 < len(asked) < 60  # 2.1 s after power-on, and the way to rest
    np.testing.assert_allclose(gaps(asked), 0.05, atol=0.005)


def test_waiting_for_a_hand_that_never_stops_ends_a_second_after_its_time(link, monkeypatch):
    link.arm()
    still = link.status()
    asked = Mock(return_value=dataclasses.replace(still, moving=True))
    monkeypatch.setattr(HandLink, "status", asked)
    link.move(ServoCommand(np.full(6, 0.01), 0.5))
    start = link._now()
    with pytest.raises(LinkTimeout, match="still moves 1 s after"):
        link.wait()
    assert link._now() - start == pytest.approx(1.5, abs=0.02)
    assert asked.call_count == pytest.approx(1000, abs=3)


def test_the_counters_of_a_session_are_exact(virtual_hand):
    link = HandLink(virtual_hand.connect)
    link.connect()
    for _ in range(3):
        link.clear()
    with pytest.raises(RejectedError, match=r"refused move: state \(state idle\)"):
        link.move(ServoCommand(np.zeros(6), 1.0))
    counted = link.statistics
    assert (counted.sent, counted.received, counted.retried, counted.rejected) == (5, 5, 0, 1)
    assert len(counted.round_trips) == 5
    link.connect()
    link.close()
    assert (counted.sent, counted.received) == (6, 6)


def test_sequence_numbers_go_round_without_zero(virtual_hand):
    exchange = Exchange(virtual_hand.connect(), LinkStatistics())
    exchange._seq = exchange._moved = 0xFFFE
    assert [exchange._frame("status", {"period_ms": 0}, 0).seq for _ in range(3)] == [0xFFFF, 1, 2]


@pytest.mark.parametrize(("method", "gone"), [("write", True), ("read", True), ("read", False)])
def test_a_call_that_is_stopped_says_so_whatever_the_port_does(virtual_hand, method, gone):
    used = Mock(side_effect=PortError("closed meanwhile") if gone else None, return_value=b"")

    def check():
        if used.called:
            raise StoppedError("stopped by close()")

    transport = virtual_hand.connect()
    setattr(transport, method, used)
    with pytest.raises(StoppedError):
        Exchange(transport, LinkStatistics(), check).request("estop", timeout=0.0, attempts=1)


@pytest.mark.parametrize("method", ["write", "read"])
def test_a_port_that_fails_in_one_direction_ends_the_call_at_once(virtual_hand, method):
    used = Mock(side_effect=PortError("the cable is off"))
    transport = virtual_hand.connect()
    setattr(transport, method, used)
    with pytest.raises(PortError, match="the cable is off"):
        Exchange(transport, LinkStatistics()).request("estop")
    assert used.call_count == 1


# --- doctor
# -----------------------------------------------------------------------------------------------------------


def test_doctor_listens_for_three_seconds_and_lets_the_port_go(deaf):
    deaf.close = Mock()
    finding = diagnose("here", lambda: deaf)
    assert "silence for 3 s" in finding.what
    assert deaf.close.called
    assert {frame.fields["nonce"] for _, frame in deaf.of("hello")} == {0}
    assert deaf.now() == pytest.approx(3.0, abs=0.15)


@pytest.mark.parametrize(
    ("bad", "accepted", "noisy"),
    [(10, 1, False), (11, 1, True), (11, 1100, False), (12, 1199, True)],
)
def test_doctor_calls_more_than_ten_and_one_in_a_hundred_damaged_frames_noise(
    link, bad, accepted, noisy
):
    status = link.status()
    for counter in ("bad_crc", "bad_frame", "overrun"):
        status.counters.update(
            {"bad_crc": 0, "bad_frame": 0, "overrun": 0, "accepted": accepted} | {counter: bad}
        )
        finding = _judge("here", link.info, status, LinkStatistics(), HPAC)
        assert (finding.port, finding.healthy) == ("here", not noisy)
        assert ("line noise" in finding.advice) is noisy
        assert not noisy or f"{bad} damaged frames" in finding.what


@pytest.mark.parametrize(
    ("heard", "what"),
    [
        (b"a" * 90 + b"\x80" * 10, "text"),
        (b"a" * 89 + b"\x80" * 11, "neither"),
        (b" ~\r\n\t" * 4, "text"),
        (b"\x1f\x7f" * 10, "neither"),
        (b"short\n" + b"long" * 30, repr("long" * 15)),
    ],
)
def test_nine_in_ten_printable_bytes_are_taken_for_text(virtual_hand, heard, what):
    exchange = Exchange(Device(virtual_hand, lambda data: heard), LinkStatistics())
    with pytest.raises(HandshakeError) as caught:
        greet(exchange, patience=0.1)
    assert what in str(caught.value)


def test_doctor_tells_what_the_board_measures_the_trims_and_the_round_trip_in_milliseconds(link):
    statistics = LinkStatistics()
    statistics.round_trips.extend([0.001, 0.002, 0.009])
    plain = _judge("here", link.info, link.status(), statistics, HPAC).what
    assert "round trip 2.0 ms" in plain
    assert not any(word in plain for word in ("supply", "heat", "trims"))
    late = _judge("here", link.info, link.status(), LinkStatistics(), HPAC).what
    assert late.endswith("boot 1; its answers come late or get lost")
    status = dataclasses.replace(
        link.status(), supply=5.018, heat=np.array([0, 0, 0.34, 0.1, 0, 0])
    )
    info = dataclasses.replace(link.info, trim_ns=(0, -300, 0, 0, 0, 20_000))
    what = _judge("here", info, status, LinkStatistics(), HPAC).what
    assert "boot 1, supply 5.02 V, heat up to 34%, trims 0 -300 0 0 0 20000 ns" in what


# --- devices that are loud, slow or half dead
# ------------------------------------------------------------------------------------


@contextmanager
def flooded(junk):
    """A port at which junk arrives without end."""

    def serve():
        connection, _ = listener.accept()
        with connection, suppress(OSError):  # until the other end closes
            while True:
                connection.sendall(junk)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}"
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
    fields = {"session": 1, "duration_ms": 500, "servo": (5000,) * 6}
    virtual_hand.receive(encode(Frame("move", 50, 0, fields))[:13])
    armed.connect()
    armed.arm()
    armed.move(ServoCommand(np.full(6, 0.2), 0.4))
    np.testing.assert_allclose(armed.wait().servo, 0.2, atol=1e-4)


# --- turns
# ------------------------------------------------------------------------------------------------------------


def test_who_preempts_waits_for_the_call_to_end_and_insists_meanwhile():
    turns = Turns()
    begun = threading.Event()
    insist = Mock()

    def call():
        with turns:
            begun.set()
            time.sleep(0.3)

    with ThreadPoolExecutor() as pool:
        other = pool.submit(call)
        begun.wait()
        with turns.preempt("estop()", insist):
            assert not turns._depth, "the other call has not ended yet"
    assert insist.call_count >= 2
    with pytest.raises(StoppedError, match=r"^stopped by estop\(\)$"):
        other.result()
    with turns:
        turns.check()


def test_who_preempts_insists_every_fiftieth_of_a_second_for_three(monkeypatch):
    clock = [0.0]
    insisted = []

    def held(blocking=True, timeout=0.0):
        clock[0] += timeout
        return False

    turns = Turns()
    turns._lock = Mock(acquire=held)
    turns._depth = 1
    monkeypatch.setattr(connection, "monotonic", lambda: clock[0])
    with turns.preempt("estop()", lambda: insisted.append(clock[0])):
        assert clock[0] == pytest.approx(3.0, abs=0.03)
    np.testing.assert_allclose(np.diff(insisted), 0.02)
    with pytest.raises(StoppedError, match=r"stopped by estop\(\)"):
        turns.check()


def test_who_preempts_nobody_stops_nobody():
    turns = Turns()
    with turns.preempt("estop()", lambda: pytest.fail("there is nobody to insist with")):
        turns.check()
    with turns:
        turns.check()
