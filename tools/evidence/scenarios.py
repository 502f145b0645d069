"""The scenarios of the safety case: each plays the virtual hand of one kind, sound or broken, and
returns the figure and the number of opportunities to break the claim."""

import struct
from contextlib import suppress
from functools import cache

import numpy as np

from hpac_gym.bridge.errors import BridgeError
from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.hands import VirtualHand, VirtualTransport
from hpac_gym.bridge.link import HandLink
from hpac_gym.bridge.protocol import CONSTANTS, Action, Reset
from hpac_gym.model import HPAC, SERVOS, ServoCommand, move_duration
from tools.evidence.judged_hand import JudgedHand
from tools.evidence.oracle import Oracle
from tools.evidence.sessions import seconds_with_pulses

BOARD_TICK_US = 20_000
"""Tick period of the slowest permitted board, one tick per servo period [µs]."""
PATIENCE = 1.0
"""How long a hand may take to fall silent before the wait for it ends [s]."""

_HALF = HPAC.servo_max / 2
_TIME = 1.1 * move_duration(_HALF, HPAC.servo_max)
_BOOT_TEXT = b"ets Jul 29 2019 12:21:46\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\n"

Played = tuple[float, int]
Hands = type[JudgedHand]


def _linked(hand: JudgedHand, action: Action = Action.relax, watchdog: float = 0.25) -> HandLink:
    """A link that has armed the hand and started a move."""
    link = HandLink(hand.connect)
    link.connect()
    link.arm(action, watchdog)
    link.move(ServoCommand(_HALF, _TIME))
    return link


def _move(session: bytes, pose: int, duration_ms: int = 1000) -> bytes:
    """Payload of a MOVE of all servos to the same angle [1e-4 rad]."""
    return session + struct.pack("<H6h", duration_ms, *[pose] * 6)


def silence(kind: Hands, action: Action) -> Played:
    """The host falls silent during a move: number of violations afterwards."""
    broken = tried = 0
    longest = 4.0 + (CONSTANTS["hold_max_ms"] * 1e-3 if action == Action.hold else 0.0)
    for number, watchdog in enumerate((0.1, 0.25, 2.0)):
        hand = kind(BOARD_TICK_US, start_us=7_300 * number)
        link = _linked(hand, action, watchdog)
        link.sleep(0.3 * _TIME)
        _pass(hand, watchdog + longest)
        broken += hand.oracle.broken.total()
        tried += hand.oracle.tried["silence"] > 0
    return broken, tried


def _pass(hand: VirtualHand, seconds: float) -> None:
    """Advance the virtual clock, ignoring the hand's messages."""
    until_us = hand.now_us + seconds * 1e6
    while hand.now_us < until_us:
        hand.run((until_us - hand.now_us) * 1e-6)


def silence_time(kind: Hands) -> Played:
    """Worst time from the end of the watchdog period to the last pulse with the action `detach`
    [ms].
    """
    worst = 0.0
    tried = 0
    for watchdog in (0.1, 0.25, 0.5, 2.0):
        for offset_us in range(0, BOARD_TICK_US, 3_700):
            hand = kind(BOARD_TICK_US, start_us=offset_us)
            link = _linked(hand, Action.detach, watchdog)
            link.heartbeat()
            tried += 1
            worst = max(worst, _ms_until_silent(hand, watchdog + PATIENCE) - watchdog * 1e3)
    return worst, tried


def _ms_until_silent(hand: VirtualHand, patience: float) -> float:
    return 1e3 * seconds_with_pulses(hand, patience, BOARD_TICK_US * 1e-6)


def fed_by_strangers(kind: Hands) -> Played:
    """The controller is silent while others request STATUS and send HEARTBEAT, MOVE and CLEAR of
    other sessions.
    """
    hand = kind()
    link = _linked(hand, Action.detach)
    session = struct.pack("<I", link.info.session ^ 1)
    others = [
        (wire.STATUS, bytes(2)),
        (wire.HEARTBEAT, session),
        (wire.MOVE, _move(session, 100, 500)),
    ]
    others += [(wire.CLEAR, session), (wire.HEARTBEAT, bytes(4)), (wire.HELLO, bytes(4))]
    for number in range(30):
        message, payload = others[number % len(others)]
        hand.receive(wire.frame(message, 1000 + number, payload))
        _pass(hand, 0.02)
    return hand.oracle.broken.total() + bool(hand.pulses().any()), 30


def random_moves(kind: Hands, rule: str, moves: int = 400) -> Played:
    """Valid and invalid moves of every kind at random times, on boards that stall for up to 0.4
    s.
    """
    oracle = _moved_at_random(kind, moves)
    return oracle.broken[rule], oracle.tried[rule]


@cache
def _moved_at_random(kind: Hands, moves: int) -> Oracle:
    """The oracle of a hand after these moves, for all the rules that they try."""
    hand = kind()
    rng = np.random.default_rng(4)
    link = _linked(hand, Action.hold, 2.0)
    for number in range(moves):
        share = rng.random(len(SERVOS)) if rng.random() < 0.7 else rng.normal(0.5, 1.0, len(SERVOS))
        duration = float(rng.choice([0.01, 0.05, 0.3, 1.0])) * rng.random() + 0.01
        start = link.status().servo
        target = np.clip(start + (HPAC.servo_max * share - start) * min(duration, 1.0), -1.0, 2.0)
        with suppress(BridgeError):
            link.move(ServoCommand(target, duration), minimum_jerk=rng.random() < 0.4, pace=False)
        if number % 10 == 0:
            hand.now_us += int(rng.integers(0, 400_000))
        with suppress(BridgeError):
            link.sleep(duration * rng.random())
    return hand.oracle


def starts(kind: Hands) -> Played:
    """Arming at rest, and again at the pose in which CLEAR has left the hand."""
    hand = kind()
    link = _linked(hand)
    for _ in range(5):
        link.wait()
        link.clear()
        _pass(hand, 0.2)
        link.arm()
        link.move(ServoCommand(_HALF, _TIME))
    return hand.oracle.broken["start"] + hand.oracle.broken["rate"], hand.oracle.tried["start"]


def unarmed(kind: Hands) -> Played:
    """Every message but ARM, before the first ARM and after CLEAR and HELLO."""
    hand = kind()
    session = struct.pack("<I", 5)
    move = (wire.MOVE, _move(session, 100))
    frames = [
        move,
        (wire.HELLO, session),
        (wire.HEARTBEAT, session),
        move,
        (wire.STATUS, struct.pack("<H", 20)),
    ]
    frames.append((wire.CLEAR, session))
    with suppress(BridgeError):
        for number, (message, payload) in enumerate(frames * 3):
            hand.receive(wire.frame(message, number + 1, payload))
            _pass(hand, 0.1)
        link = _linked(hand)
        link.clear()
        _pass(hand, 0.5)
    return hand.oracle.broken["unarmed"], hand.oracle.tried["unarmed"]


def estops(kind: Hands) -> Played:
    """ESTOP at any time with any flags, payload, version and sequence number: worst time to the
    last pulse [ms].
    """
    rng = np.random.default_rng(3)
    worst = 0.0
    tried = 0
    for number in range(24):
        hand = kind(BOARD_TICK_US, start_us=1_700 * number)
        link = _linked(hand, Action(number % 3))
        link.sleep(_TIME * rng.random())
        payload = rng.bytes(int(rng.integers(0, 12))) if number % 2 else b""
        frame = wire.frame(
            wire.ESTOP,
            int(rng.integers(0x10000)),
            payload,
            int(rng.integers(256)),
            int(rng.integers(256)),
        )
        tried += bool(hand.pulses().all())
        hand.receive(frame)
        worst = max(worst, _ms_until_silent(hand, PATIENCE))
    return worst, tried


def ways_out_of_a_fault(kind: Hands) -> Played:
    """After an e-stop, every message except the session's CLEAR: number of them that restore pulses
    or leave the fault.
    """
    hand = kind()
    link = _linked(hand, Action.detach)
    link.estop()
    out = 0
    tried = 0
    session = struct.pack("<I", link.info.session)
    arm = session + struct.pack("<IHB", link.info.limits_hash, 250, 0)
    move = _move(session, 100)
    frames = [
        (wire.ARM, arm),
        (wire.MOVE, move),
        (wire.HEARTBEAT, session),
        (wire.STATUS, bytes(2)),
        (wire.ESTOP, b""),
    ]
    frames += [
        (wire.CLEAR, struct.pack("<I", link.info.session ^ 1)),
        (wire.HELLO, bytes(4)),
        (wire.HELLO, session),
    ]
    for number, (message, payload) in enumerate(frames, 1000):
        hand.receive(wire.frame(message, number, payload))
        _pass(hand, 0.1)
        tried += 1
        out += link.status().state != "fault" or bool(hand.pulses().any())
    return out, tried


def old_moves(kind: Hands) -> Played:
    """Repetition of the same MOVE and of older ones: after later ones, and after CLEAR and ARM."""
    hand = kind()
    link = _linked(hand, Action.hold, 2.0)
    link.wait()
    session = struct.pack("<I", link.info.session)
    moves = [wire.frame(wire.MOVE, 30_000 + i, _move(session, 1000 * (i + 1))) for i in range(5)]
    for move in moves:
        hand.receive(move)
        link.sleep(1.1)
    tried = 0
    for _ in range(2):
        before = link.status().servo
        for move in moves[:-1] if tried == 0 else moves:
            hand.receive(move)
            link.sleep(0.1)
            tried += 1
        moved = float(np.abs(link.status().servo - before).max())
        link.clear()
        link.arm(Action.hold, 2.0)
    return hand.oracle.broken["accept"] + (moved > 0), tried


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
            _pass(hand, float(rng.choice([0.001, 0.02, 0.3])))
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
    hand = kind()
    link = _linked(hand, Action.hold, 2.0)
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
    hand = kind(BOARD_TICK_US)
    link = _linked(hand, Action.hold)
    link.move(ServoCommand(HPAC.servo_max, _TIME))
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
                link.move(ServoCommand(_HALF, _TIME))
                link.sleep(2.0)
                lost += 1
            lost += bool(hand.pulses().any())
        except BridgeError:
            lost += 1
        finally:
            link.close()
    return lost, min(seen["in a session"], seen["bytes"] // len(_BOOT_TEXT))
