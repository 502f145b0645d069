"""Virtual hands that an oracle checks, and hands with one fault each: the negative controls of the
evidence.
"""

import struct
from collections.abc import Callable

import numpy as np

from hpac_gym.bridge import Reset, VirtualHand
from hpac_gym.bridge.evidence import codec as wire
from tools.evidence.oracle import Oracle


class JudgedHand(VirtualHand):
    """A virtual hand that an oracle checks; negative controls override its hooks `heard`, `shown`
    and `ticked`.

    Args:
        period_us: period of the board's ticks [µs].
        start_us: initial value of the clock [µs].
    """

    def __init__(self, period_us: int = 1000, start_us: int = 0) -> None:
        self.oracle = Oracle(period_us=period_us)
        super().__init__(period_us, on_pulses=self._judge, start_us=start_us)

    def _judge(self, now_us: int, widths: np.ndarray) -> None:
        self.oracle.pulses(now_us, widths)
        self.ticked()

    def ticked(self) -> None:
        """Hook: called after every tick of the core."""

    def restart(self, reset: Reset = Reset.power_on, boot_count: int = 1) -> None:
        self.oracle.power_on()
        super().restart(reset, boot_count)

    def receive(self, data: bytes) -> None:
        self.oracle.said.host(self.now_us, data)
        super().receive(self.heard(data))

    def transmit(self) -> bytes:
        said = super().transmit()
        self.oracle.said.device(self.now_us, said)
        return said

    def pulses(self) -> np.ndarray:
        """The pulse widths, modified by `shown`."""
        return np.array(self.shown(self.now_us, super().pulses().tolist()), dtype=np.int64)

    def heard(self, data: bytes) -> bytes:
        """Hook: the bytes that the core receives when ``data`` arrives."""
        return data

    def shown(self, now_us: int, widths: list[int]) -> list[int]:
        """Hook: the pulse widths at the servos when the core outputs ``widths`` [ns]."""
        return widths


def _rewritten(
    data: bytes, change: Callable[[bytearray], bytes | None], mend: bool = False
) -> bytes:
    """Change and re-encode every intact frame, or drop it; damaged frames pass unchanged unless
    ``mend`` is set.
    """
    out = b""
    for piece in filter(None, data.split(b"\0")):
        opened = wire.unseal(piece)
        if opened is None or not (opened[1] or mend):
            out += b"\0" + piece + b"\0"
        elif (body := change(bytearray(opened[0]))) is not None:
            out += wire.seal(bytes(body))
    return out


class DeafToEstop(JudgedHand):
    """A hand that ignores ESTOP."""

    def heard(self, data: bytes) -> bytes:
        return _rewritten(data, lambda body: None if body[1] == wire.ESTOP else body)


class NoWatchdog(JudgedHand):
    """A hand that feeds its own watchdog."""

    def ticked(self) -> None:
        if self.oracle.said.session:
            feed = wire.frame(
                wire.HEARTBEAT, 0xFFFF, struct.pack("<I", self.oracle.said.session), wire.NO_ACK
            )
            self._library.hpac_hand_receive(self._hand, self._config, self.now_us, feed, len(feed))


class MovesOn(JudgedHand):
    """A hand that continues to move in a fault: the servo pulses drift by 0.05 rad/s."""

    def shown(self, now_us: int, widths: list[int]) -> list[int]:
        silent_us = max(now_us - getattr(self, "heard_us", now_us) - 600_000, 0)
        return [width + int(silent_us * 0.03) if width else 0 for width in widths]

    def heard(self, data: bytes) -> bytes:
        self.heard_us = self.now_us
        return data


class Coarse(JudgedHand):
    """A hand that moves in steps of 0.03 rad."""

    def shown(self, now_us: int, widths: list[int]) -> list[int]:
        return [width // 20_000 * 20_000 for width in widths]


class Babbling(JudgedHand):
    """A hand that sends text instead of frames."""

    def transmit(self) -> bytes:
        return b"x" * len(super().transmit())


class Shifted(JudgedHand):
    """A hand whose first servo is 0.5 rad off."""

    def shown(self, now_us: int, widths: list[int]) -> list[int]:
        return [widths[0] and widths[0] - 318_310, *widths[1:]]


class StartsAtOnce(JudgedHand):
    """A hand that starts all of its servos together."""

    def shown(self, now_us: int, widths: list[int]) -> list[int]:
        return (
            widths if all(widths) or not any(widths) else [width or 1_500_000 for width in widths]
        )


class AlwaysOn(JudgedHand):
    """A hand that has pulses from power-on."""

    def shown(self, now_us: int, widths: list[int]) -> list[int]:
        return [width or 1_500_000 for width in widths]


class Forgiving(JudgedHand):
    """A hand that accepts frames that it should refuse: it repairs damaged frames and wrong
    sessions.
    """

    def heard(self, data: bytes) -> bytes:
        return _rewritten(data, self._mend, mend=True)

    def _mend(self, body: bytearray) -> bytes:
        if body[1] in (wire.ARM, wire.MOVE, wire.HEARTBEAT, wire.CLEAR):
            body[5:9] = struct.pack("<I", self.oracle.said.session)
        return bytes(body)


class Renumbering(JudgedHand):
    """A hand that treats every MOVE as a new one."""

    seq = 0

    def heard(self, data: bytes) -> bytes:
        return _rewritten(data, self._renumber)

    def _renumber(self, body: bytearray) -> bytes:
        if body[1] == wire.MOVE:
            self.seq += 1
            self.asked[self.seq] = bytes(body[2:4])
            body[2:4] = struct.pack("<H", self.seq)
        return bytes(body)

    def transmit(self) -> bytes:
        said = VirtualHand.transmit(self)
        said = _rewritten(said, self._number_back)
        self.oracle.said.device(self.now_us, said)
        return said

    def _number_back(self, body: bytearray) -> bytes:
        if body[1] == wire.ACK and body[5] == wire.MOVE:
            body[2:4] = self.asked.get(struct.unpack_from("<H", body, 2)[0], body[2:4])
        return bytes(body)

    def __init__(self, *args: int, **kwargs: int) -> None:
        self.asked: dict[int, bytes] = {}
        super().__init__(*args, **kwargs)
