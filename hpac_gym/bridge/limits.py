"""The servo table on the wire: limits in integer units, taken from the hand's parameters, and their hash.

Host and firmware compare the hash in the handshake, so that neither drives a hand that the other does not know.
"""

from __future__ import annotations

import zlib
from dataclasses import astuple, dataclass

import numpy as np

from hpac_gym.bridge.protocol import ANGLE_UNIT, PULSE, VERSION
from hpac_gym.model import HPAC, SERVOS, Hand


@dataclass(frozen=True, slots=True)
class ServoLimits:
    """What one servo may do, in the units of the firmware."""

    name: str
    min_urad: int
    max_urad: int
    rest_urad: int
    centre_urad: int
    rate_urad_s: int
    ns_per_rad: int
    centre_ns: int


def servo_limits(hand: Hand = HPAC) -> tuple[ServoLimits, ...]:
    """The servo table of a hand, in the order of `SERVOS`.

    Angles are rounded to the wire's step, so that a command for exactly the limit is accepted. Rest is 0 rad, or the
    limit nearest to it; the pulse's centre stands at the middle of the range.
    """
    step = round(ANGLE_UNIT * 1e6)
    lower = np.rint(hand.servo_min / ANGLE_UNIT).astype(int) * step
    upper = np.rint(hand.servo_max / ANGLE_UNIT).astype(int) * step
    rate = np.rint(np.broadcast_to(hand.servo_rate_limit, len(SERVOS)) * 1e6).astype(int)
    return tuple(
        ServoLimits(
            name=name,
            min_urad=int(lower[i]),
            max_urad=int(upper[i]),
            rest_urad=int(min(max(0, lower[i]), upper[i])),
            centre_urad=int(lower[i] + upper[i]) // 2,
            rate_urad_s=int(rate[i]),
            ns_per_rad=PULSE["ns_per_rad"],
            centre_ns=PULSE["centre_ns"],
        )
        for i, name in enumerate(SERVOS)
    )


def limits_hash(hand: Hand = HPAC) -> int:
    """CRC-32 of the protocol version and the servo table."""
    rows = [",".join(map(str, astuple(servo))) for servo in servo_limits(hand)]
    return zlib.crc32("\n".join([f"hpac {VERSION}", *rows]).encode())
