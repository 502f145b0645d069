"""Scenes with frames that nobody should send: hostile and damaged ones, more than the board can read,
and an endless restart."""

import struct
from contextlib import suppress

import numpy as np

from hpac_gym.bridge import Action, BridgeError, HandLink, Reset
from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.hands import VirtualHand, VirtualTransport
from hpac_gym.model import HPAC, ServoCommand
from tools.evidence.scenarios import BOARD_TICK_US, HALF, TIME, Hands, Played, let_pass, linked

_BOOT_TEXT = b"ets Jul 29 2019 12:21:46\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\n"


def hostile(kind: Hands, frames: int) -> Played:
    """Valid, absurd, damaged and foreign frames at random times: violations of any rule of the
    oracle.
    """
    rng = np.random.default_rng(6)
    hand = kind()
    link = HandLink(hand.connect)
    link.connect()
    limits_hash = link.info.limits_hash
    session = link.info.session
    for number in range(frames):
        hand.receive(_hostile_frame(rng, session, limits_hash, number))
        hand.transmit()
        if rng.random() < 0.02:  # otherwise a fault would block all later frames
            hand.receive(wire.frame(wire.CLEAR, number % 0x10000, struct.pack("<I", session)))
            hand.transmit()
        if rng.random() < 0.05:
            let_pass(hand, float(rng.choice([0.001, 0.02, 0.3])))
    return hand.oracle.broken.total(), frames


def _hostile_frame(rng: np.random.Generator, session: int, limits_hash: int, number: int) -> bytes:
    kinds = [wire.ARM, wire.MOVE, wire.HEARTBEAT, wire.CLEAR, wire.STATUS, wire.ESTOP, 9]
    kind = int(rng.choice(kinds, p=[0.3, 0.4, 0.2, 0.02, 0.05, 0.01, 0.02]))
    nonce = struct.pack("<I", session if rng.random() < 0.9 else int(rng.integers(2**32)))
    payload = {
        wire.ARM: nonce
        + struct.pack("<IHB", limits_hash, int(rng.integers(50, 2500)), int(rng.integers(0, 4))),
        wire.MOVE: nonce
        + struct.pack("<H6h", int(rng.integers(5, 3000)), *rng.integers(-500, 16_000, 6).tolist()),
        wire.STATUS: bytes(2),
        wire.ESTOP: b"",
    }.get(kind, nonce)
    if rng.random() < 0.03:
        payload = payload[: rng.integers(len(payload) + 1)] + rng.bytes(int(rng.integers(3)))
    flags = int(rng.integers(256)) if rng.random() < 0.05 else 0
    data = bytearray(wire.frame(kind, number % 0x10000, payload, flags))
    if rng.random() < 0.1:
        data[int(rng.integers(1, len(data) - 1))] ^= 1 << int(rng.integers(8))
    return bytes(data)


def damaged(kind: Hands, frames: int = 3000) -> Played:
    """MOVE frames with one to eight flipped bits: number of executed ones."""
    rng = np.random.default_rng(8)
    hand, link = linked(kind(), Action.hold, 2.0)
    damaged = 0
    for number in range(frames):
        move = struct.pack("<IH6h", link.info.session, 1000, *rng.integers(0, 10_000, 6).tolist())
        intact = wire.frame(wire.MOVE, 5 + number % 30_000, move)
        data = bytearray(intact)
        for _ in range(int(rng.integers(1, 9))):
            data[int(rng.integers(1, len(data) - 1))] ^= 1 << int(rng.integers(8))
        damaged += bytes(data) != intact
        hand.receive(bytes(data))
        hand.transmit()
        if number % 20 == 0:
            with suppress(BridgeError):
                link.heartbeat()
    return hand.oracle.broken["accept"], damaged


def overload(kind: Hands) -> Played:
    """Time until a fully closed hand opens by itself [s]."""
    hand, link = linked(kind(BOARD_TICK_US), Action.hold)
    link.move(ServoCommand(HPAC.servo_max, TIME))
    start_us = hand.now_us
    with suppress(BridgeError):
        while hand.now_us - start_us < 400e6:
            link.sleep(1.0)
    while hand.pulses().any() and hand.now_us - start_us < 400e6:
        hand.run(0.1)
    return (hand.now_us - start_us) * 1e-6, 1


class _Restarting(VirtualTransport):
    """A board that restarts when its port opens and again after `restart_at` writes, sending boot
    text each time.
    """

    def __init__(self, hand: VirtualHand, restart_at: int, seen: dict[str, int]) -> None:
        super().__init__(hand)
        self._left = restart_at
        self._seen = seen
        self._restart()

    def _restart(self) -> None:
        self._seen["in a session"] += bool(self._hand.pulses().any())
        self._hand.restart(Reset.power_on)
        self._text = _BOOT_TEXT
        self._deaf_until_us = self._hand.now_us + 300_000

    def write(self, data: bytes) -> None:
        self._left -= 1
        if self._left == 0:
            self._restart()
        if self._hand.now_us >= self._deaf_until_us:
            super().write(data)

    def read(self, timeout: float) -> bytes:
        text = self._text
        self._text = b""
        self._seen["bytes"] += len(text)
        return text + super().read(timeout)


def boots(kind: Hands) -> Played:
    """Sessions with boards that restart at opening and during the session: number that are lost or
    leave pulses.
    """
    lost = 0
    seen = {"in a session": 0, "bytes": 0}
    for restart_at in range(8, 28):
        hand = kind()
        link = HandLink(
            lambda hand=hand, at=restart_at: _Restarting(hand, at, seen), handshake_timeout=1.0
        )
        try:
            link.connect()
            with suppress(BridgeError):  # the restart must end the session with an error
                link.arm()
                link.move(ServoCommand(HALF, TIME))
                link.sleep(2.0)
                lost += 1
            lost += bool(hand.pulses().any())
        except BridgeError:
            lost += 1
        finally:
            link.close()
    return lost, min(seen["in a session"], seen["bytes"] // len(_BOOT_TEXT))
