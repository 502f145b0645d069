"""Find hands, say what is wrong with each, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from serial.tools import list_ports

from hpac_gym.bridge.errors import BridgeError, HandshakeError, PortError
from hpac_gym.bridge.limits import limits_hash
from hpac_gym.bridge.link import HandLink
from hpac_gym.bridge.transport import Transport
from hpac_gym.model import HPAC, Hand


@dataclass(frozen=True, slots=True)
class Finding:
    """What is known about one port."""

    port: str
    healthy: bool
    what: str
    advice: str = ""

    def __str__(self) -> str:
        mark = "ok " if self.healthy else "BAD"
        return f"{mark} {self.port}: {self.what}" + (f"\n      → {self.advice}" if self.advice else "")


def find_ports() -> list[str]:
    """Serial ports of this machine that could be a hand: those behind USB."""
    return sorted(port.device for port in list_ports.comports() if port.vid is not None)


def diagnose(name: str, port: str | Callable[[], Transport], hand: Hand = HPAC) -> Finding:
    """Greet what is at a port, without arming it.

    Args:
        name: how the finding calls the port.
        port: as in `HandLink`.
        hand: whose limits the firmware should have.
    """
    link = HandLink(port, hand=hand)
    try:
        with link:
            return _judge(name, link, hand)
    except PortError as error:
        what, _, advice = str(error).removeprefix(f"{name} ").removeprefix(f"{name}: ").partition("; ")
        return Finding(name, False, what, advice)
    except HandshakeError as error:
        return Finding(name, False, str(error), _handshake_advice(str(error)))
    except BridgeError as error:
        advice = "frames get lost: try a shorter cable, and another USB port without a hub"
        return Finding(name, False, str(error), advice)


def _handshake_advice(text: str) -> str:
    if "silence" in text:
        return "is the board powered and flashed with the hand's firmware? see firmware/board/esp32/README.md"
    if "protocol" in text:
        return "flash the firmware of this version of hpac_gym, or install the version that the firmware came with"
    return "something else talks here: another firmware, or log text on the command port (see sdkconfig.defaults)"


def _judge(name: str, link: HandLink, hand: Hand) -> Finding:
    info = link.info
    status = link.status()
    what = f"hand with firmware {info.firmware_version}, state {status.state}, reset {info.reset}, boot {info.boot_count}"
    if info.limits_hash != limits_hash(hand):
        advice = "python -m hpac_gym.bridge.generate, then build and flash: the firmware was made for another hand"
        return Finding(name, False, f"{what}; servo limits {info.limits_hash:08x}, wanted {limits_hash(hand):08x}", advice)
    advice = {
        "none": "",
        "brownout": "the supply sagged: give the servos their own supply, 5 to 6 V and 6 A or more, ground in common; then CLEAR",
        "crash": "the firmware crashed or hung; please report what came before; CLEAR leaves the fault",
        "config": "pins.h has a trim or direction that takes a pulse out of 0.5 to 2.5 ms: correct it and flash",
        "overload": "a servo was held closed too long: let it cool for a minute, then CLEAR",
    }.get(status.fault, "CLEAR leaves the fault")
    if advice:
        return Finding(name, False, f"{what}, fault {status.fault}", advice)
    bad = status.counters["bad_crc"] + status.counters["bad_frame"] + status.counters["overrun"]
    if bad > 10 and bad > status.counters["accepted"] // 100:
        return Finding(name, False, f"{what}; {bad} damaged frames", "line noise: a shorter cable, away from the servo wires")
    return Finding(name, True, f"{what}; round trip {1e3 * link.statistics.round_trip(50):.1f} ms")
