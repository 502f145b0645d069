"""Find hands and report the fault and first remedy of each. Read-only: no hand is taken over, moved
or disarmed.
"""

from collections.abc import Callable
from dataclasses import dataclass

from serial.tools import list_ports

from hpac_gym.bridge.connection import NOISE, greet, require_answer
from hpac_gym.bridge.errors import HandshakeError, LinkTimeout, PortError
from hpac_gym.bridge.exchange import Exchange, LinkStatistics
from hpac_gym.bridge.protocol import LOAD
from hpac_gym.bridge.reports import HandInfo, HandStatus
from hpac_gym.bridge.transport import Transport, open_transport
from hpac_gym.model import HPAC, Hand

_PATIENCE = 3.0
"""Time-out [s]; boards that reset when their port opens need up to 2 s."""

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
        return Finding(name, False, "a hand that answers only some messages", NOISE)
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
    status = HandStatus.from_frame(require_answer("status", exchange.request("status")))
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
        return Finding(name, False, f"{what}; {bad} damaged frames", NOISE)
    late = "its answers come late or get lost"
    trip = f"round trip {1e3 * statistics.round_trip(50):.1f} ms"
    return Finding(name, True, f"{what}; {trip if statistics.round_trips else late}")
