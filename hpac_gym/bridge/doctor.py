"""What is at the other end: greet a device, find hands, and report the fault and first remedy of each.
A diagnosis is read-only: no hand is taken over, moved or disarmed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from serial.tools import list_ports

from hpac_gym.bridge.errors import HandshakeError, LinkTimeout, PortError
from hpac_gym.bridge.exchange import Exchange, LinkStatistics
from hpac_gym.bridge.protocol import LOAD, VERSION, Fields, Frame, Reason, name_of
from hpac_gym.bridge.reports import HandInfo, HandStatus
from hpac_gym.bridge.transport import Transport, open_transport
from hpac_gym.model import HPAC, Hand

_PATIENCE = 3.0
"""Time-out [s]; boards that reset when their port opens need up to 2 s."""
_HELLO_PERIOD = 0.1
_TEXT_SHARE = 0.9
_NOISE = "line noise: a shorter cable, away from the servo wires"

_FAULT_STEPS = {
    "brownout": "the supply sagged: give the servos one of their own, 5 to 6 V, 6 A or more, ground in common; then hpac clear",
    "crash": "the firmware crashed or hung: report what came before; then hpac clear",
    "supply": "the servo supply fell too low: 5 to 6 V and 6 A or more are needed; then hpac clear",
    "config": "pins.h has a trim outside of −32,768 to 32,767 ns, or a trim or direction that takes a pulse out of "
    "0.5 to 2.5 ms: correct it and flash",
    "overload": "a servo was held closed too long: let it cool for a minute, then hpac clear",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """Diagnosis of one port."""

    port: str
    healthy: bool
    what: str
    advice: str = ""
    """First remedy."""

    def __str__(self) -> str:
        mark = "ok " if self.healthy else "BAD"
        return f"{mark} {self.port}: {self.what}" + (
            f"\n      → {self.advice}" if self.advice else ""
        )


def find_ports() -> list[str]:
    """Serial ports that could be a hand: those connected through USB."""
    return sorted(port.device for port in list_ports.comports() if port.vid is not None)


def diagnose(name: str, port: str | Callable[[], Transport], hand: Hand = HPAC) -> Finding:
    """Query the device at a port with HELLO 0, which changes nothing, and with STATUS unless the
    hand is armed.

    Args:
        name: name of the port in the finding.
        port: as in `HandLink`.
        hand: the hand whose limits the firmware should have.
    """
    try:
        transport = open_transport(port)
    except PortError as error:
        what, _, advice = _without_name(error, name).partition("; ")
        return Finding(name, False, what, advice)
    try:
        return _examined(name, Exchange(transport, LinkStatistics()), hand)
    except HandshakeError as error:
        what, _, advice = str(error).rpartition("; ")
        return Finding(name, False, what, advice)
    except LinkTimeout:
        return Finding(name, False, "a hand that answers only some messages", _NOISE)
    except PortError as error:
        advice = "plug it in again, and look for a loose cable"
        return Finding(name, False, _without_name(error, name), advice)
    finally:
        transport.close()


def _without_name(error: PortError, name: str) -> str:
    return str(error).removeprefix(f"{name} ").removeprefix(f"{name}: ")


def _examined(name: str, exchange: Exchange, hand: Hand) -> Finding:
    info = greet(exchange, _PATIENCE, {"nonce": 0})
    if info.state == "armed":
        what = f"hand with firmware {info.firmware_version}, armed by session {info.session:08x}: left alone"
        advice = "stop the program that controls it before you start another, or run hpac estop"
        return Finding(name, True, what, advice)
    status = HandStatus.from_frame(_require_answer("status", exchange.request("status")))
    return _judge(name, info, status, exchange.statistics, hand)


def _judge(
    name: str, info: HandInfo, status: HandStatus, statistics: LinkStatistics, hand: Hand
) -> Finding:
    what = f"hand with firmware {info.firmware_version}, state {status.state}, reset {info.reset}, boot {info.boot_count}"
    what += f", supply {status.supply:.2f} V" if status.supply > 0 else ""
    what += f", heat up to {max(status.heat):.0%}" if any(status.heat) else ""
    what += f", trims {' '.join(map(str, info.trim_ns))} ns" if any(info.trim_ns) else ""
    if status.fault != "none":
        what += f", fault {status.fault}"
        what += f", pulses on {len(status.attached)} servos" if status.attached else ""
        return Finding(name, False, what, _FAULT_STEPS.get(status.fault, "hpac clear"))
    try:
        info.table_of(hand)
    except HandshakeError as error:
        limits, _, advice = str(error).partition(": ")
        return Finding(name, False, f"{what}; {limits}", advice)
    if status.rate_share < 1:
        advice = f"let it cool below {LOAD['derate_from_percent']}%: hotter, it is not armed"
        return Finding(name, False, what, advice)
    bad = status.counters["bad_crc"] + status.counters["bad_frame"] + status.counters["overrun"]
    if bad > 10 and bad > status.counters["accepted"] // 100:
        return Finding(name, False, f"{what}; {bad} damaged frames", _NOISE)
    late = "its answers come late or get lost"
    trip = f"round trip {1e3 * statistics.round_trip(50):.1f} ms"
    return Finding(name, True, f"{what}; {trip if statistics.round_trips else late}")


def greet(exchange: Exchange, patience: float, fields: Fields | None = None) -> HandInfo:
    """Send HELLO for up to `patience` [s] and return the answer.

    Raises:
        HandshakeError: No answer, or not from a hand of this protocol: what the device is; the first
            remedy.
        PortError: The port is gone.
    """
    attempts = max(1, math.ceil(patience / _HELLO_PERIOD))
    received = exchange.statistics.received
    try:
        answer = exchange.request("hello", fields, timeout=_HELLO_PERIOD, attempts=attempts)
    except LinkTimeout:
        some = "a hand that answers only some messages; " + _NOISE
        partly = exchange.statistics.received > received
        raise HandshakeError(some if partly else _unlike_a_hand(exchange, patience)) from None
    return HandInfo.from_frame(_require_answer("hello", answer))


def _require_answer(name: str, answer: Frame) -> Frame:
    """The answer to a question, which a hand does not answer with an ACK.

    Raises:
        HandshakeError: It is an ACK.
    """
    if answer.name == "ack":
        reason = name_of(Reason, answer.number("reason"))
        raise HandshakeError(
            f"a device that answers {name.upper()} with an ACK ({reason}); flash the hand's firmware of this version"
        )
    return answer


def _unlike_a_hand(exchange: Exchange, patience: float) -> str:
    """What a device is that has not answered HELLO for `patience` [s], and the first remedy."""
    heard = exchange.splitter.tail
    if exchange.host_frames:
        return (
            f"no hand answers, but an echo: what is sent comes back ({len(heard)} bytes); "
            "take off a jumper between TX and RX, or switch the device's echo off"
        )
    if (version := exchange.splitter.other_version) is not None:
        return (
            f"a hand that speaks protocol {version}, this library {VERSION}; "
            "flash the firmware of this version of hpac_gym, or install the version that the firmware came with"
        )
    if not heard:
        return (
            f"no hand answers: silence for {patience:g} s; "
            "is the board powered and flashed with the hand's firmware? see firmware/board/esp32/README.md"
        )
    if sum(byte in b"\r\n\t" or 32 <= byte < 127 for byte in heard) >= _TEXT_SHARE * len(heard):
        line = max(heard.decode("ascii", "replace").split("\n"), key=len).strip()[:60]
        return (
            f"no hand answers: text instead of frames ({len(heard)} bytes, such as {line!r}); "
            "another firmware, or log text on the command port: flash the hand's, or move its console (sdkconfig.defaults)"
        )
    return (
        f"no hand answers: {len(heard)} bytes that are neither frames nor text; "
        "another baud rate, or noise: check the rate (460,800), ground, and that TX meets RX"
    )
